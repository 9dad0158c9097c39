#!/usr/bin/env python3
"""The weights of the verdict's chance of being wrong, from simulated scans: measured data have no part in them.

chance.py make FOLDER [SURFACE...]         simulated pairs of shapes drawn here, and of binary STL files in mm, with a manifest
trustbench.py FOLDER --out DIR --poses 6   right and wrong poses of them, judged
chance.py fit DIR/answers.json             the weights, and how well they order objects that they were not fitted to

docs/method/trustbench.md says what the chance is of. It needs Python 3.9, numpy and scipy.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from trustbench import about, drawn_on, moved, stl, turned, write, write_points, write_stl

# How each sensor errs as osteoflow knows it: noise, patches, shared along the normal and along the axes, mm; outliers; what counts as right, mm; points.
SENSORS = {
    "structured_light": (0.05, 0.1, 0.0, 0.0, 0.01, 1.5, 4000),
    "laser": (0.05, 0.1, 0.05, 0.0, 0.02, 1.5, 4000),
    "stylus": (0.1, 0.3, 0.1, 0.2, 0.01, 3.0, 300),
    "depth_camera": (0.3, 1.5, 1.0, 0.0, 0.05, 6.0, 3000),
    "ultrasound": (0.6, 1.2, 0.5, 1.2, 0.05, 5.0, 3000),
}


def drawn_shape(rng):
    """A closed surface: an ellipsoid with smooth bumps, as bones have, of 40 to 250 mm."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 121)[:-1], np.linspace(0.02, np.pi - 0.02, 60))
    way = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
    radius = np.ones(u.shape)
    for _ in range(rng.integers(4, 12)):
        middle = rng.normal(size=3)
        radius += rng.uniform(-0.35, 0.35) * np.exp(-rng.uniform(2, 30) * (1 - way @ (middle / np.linalg.norm(middle))))
    corners = way * radius[..., None] * np.exp(rng.uniform(np.log(12), np.log(90), 3))
    ring, face = np.arange(120), []
    for row in range(59):
        a, b = row * 120 + ring, row * 120 + (ring + 1) % 120
        face += [np.stack([a, a + 120, b], axis=1), np.stack([b, a + 120, b + 120], axis=1)]
    face = np.concatenate(face)
    points = corners.reshape(-1, 3)
    ends = [np.tile(points[rows].mean(axis=0), (120, 1)) for rows in (ring, 7080 + ring)]
    top = np.stack([points[ring], points[(ring + 1) % 120], ends[0]], axis=1)
    bottom = np.stack([points[7080 + (ring + 1) % 120], points[7080 + ring], ends[1]], axis=1)
    return np.concatenate([points[face], top, bottom])


def drawn_scan(rng, corners, sensor):
    """Points that the sensor sees from one or several sides, in its own coordinates, with the pose that brings them back."""
    noise, patch, bias, shift, outliers, _, n = SENSORS[sensor]
    points, normals = drawn_on(rng, corners, 40_000)
    middle, size = points.mean(axis=0), np.linalg.norm(np.ptp(points, axis=0))
    seen = np.zeros(len(points), bool)
    for _ in range(rng.integers(1, 4)):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        # The nearest point of each cell across the line of sight hides what is well behind it.
        cell = np.floor(points @ np.linalg.svd(way[None])[2][1:].T / (size / 60)).astype(int)
        cell, depth = np.unique(cell, axis=0, return_inverse=True)[1].ravel(), points @ way
        nearest = np.full(cell.max() + 1, -np.inf)
        np.maximum.at(nearest, cell, depth)
        seen |= (normals @ way > 0.2) & (depth > nearest[cell] - size / 15)
    centre = points[seen][rng.integers(seen.sum())]
    part = np.quantile(np.linalg.norm(points[seen] - centre, axis=1), rng.uniform(0.4, 1.0))
    seen &= np.linalg.norm(points - centre, axis=1) <= part
    chosen = rng.choice(np.flatnonzero(seen), min(n, seen.sum()), replace=False)
    points, normals = points[chosen], normals[chosen]
    # A smooth random field: what neighbours share.
    waves = rng.normal(size=(60, 3)) / rng.uniform(5, 25)
    field = np.sqrt(2 / 60) * np.cos(points @ waves.T + rng.uniform(0, 2 * np.pi, 60)).sum(axis=1)
    off = rng.normal(0, noise, len(points)) + patch * field + rng.normal(0, bias)
    off += (rng.random(len(points)) < outliers) * rng.normal(0, 5 * (noise + patch), len(points))
    points = points + off[:, None] * normals + rng.normal(0, max(shift, 1e-9), 3)
    pose = about(middle, turned(rng.normal(size=3), rng.uniform(0, np.pi)), rng.normal(0, 100, 3))
    return moved(np.linalg.inv(pose), points), pose


def make(folder, surfaces, seed, n_shapes):
    rng, pairs = np.random.default_rng(seed), []
    drawn = [(f"shape_{index}", drawn_shape(rng)) for index in range(n_shapes)]
    for name, corners in [(path.stem, stl(path)) for path in surfaces] + drawn:
        folder.mkdir(parents=True, exist_ok=True)
        write_stl(folder / f"{name}.stl", corners)
        for sensor, stated in SENSORS.items():
            points, pose = drawn_scan(rng, corners, sensor)
            write_points(folder / f"{name}_{sensor}.xyz", points)
            pairs.append({"object": name, "scan": sensor, "surface": f"{name}.stl", "source": f"{name}_{sensor}.xyz", "t_surface_scan": [pose.tolist()],
                          "right_mm": stated[5], "truth_mm": 0.0, "settings": {"ct_surface.sensor.like": sensor}})
    write(folder / "manifest.json", json.dumps({"pairs": pairs}, indent=1) + "\n")


def fitted(signs, wrong):
    """Log odds without a sign and of each: a logistic regression with right and wrong weighing alike, in which no sign speaks for an answer."""
    weight, side = np.where(wrong, 0.5 / np.mean(wrong), 0.5 / np.mean(~wrong)), np.where(wrong, 1, -1)

    def loss(found):
        log_odds = found[0] + signs @ found[1:]
        slope = -weight * side / (1 + np.exp(side * log_odds))
        return (np.sum(weight * np.logaddexp(0, -side * log_odds)) + 0.5 * np.sum(found[1:] ** 2),
                np.concatenate([[slope.sum()], signs.T @ slope + found[1:]]))

    limits = [(None, None)] + [(0, None)] * signs.shape[1]
    return minimize(loss, np.zeros(signs.shape[1] + 1), jac=True, method="L-BFGS-B", bounds=limits).x


def fit(answers):
    rows = [row for row in answers["rows"] if row["label"] in ("right", "wrong") and "far" in (row["signs"] or {})]
    names = sorted({name for row in rows for name in row["signs"]})
    signs = np.array([[row["signs"].get(name, 0.0) for name in names] for row in rows])
    wrong, objects = np.array([row["label"] == "wrong" for row in rows]), np.array([row["object"] for row in rows])
    found = fitted(signs, wrong)
    print(f"{(~wrong).sum()} right and {wrong.sum()} wrong answers of {len(set(objects))} objects\n\nconst WITHOUT: f64 = {found[0]:.2f};")
    for name, weight in zip(names, found[1:]):
        print(f'    ("{name}", {weight:.2f}),')
    # Of objects that the weights were not fitted to.
    log_odds = np.zeros(len(rows))
    for left_out in set(objects):
        of = fitted(signs[objects != left_out], wrong[objects != left_out])
        log_odds[objects == left_out] = (of[0] + signs @ of[1:])[objects == left_out]
    ahead = (log_odds[wrong][:, None] > log_odds[~wrong]) + 0.5 * (log_odds[wrong][:, None] == log_odds[~wrong])
    print(f"\nAUROC of objects left out: {ahead.mean():.3f}\n\n| Stated | Right | Wrong | Wrong, if half were |\n|---|---|---|---|")
    stated, weight = 1 / (1 + np.exp(-log_odds)), np.where(wrong, 0.5 / np.mean(wrong), 0.5 / np.mean(~wrong))
    for low, high in zip([0, 0.02, 0.1, 0.5, 0.9, 0.98], [0.02, 0.1, 0.5, 0.9, 0.98, 1.01]):
        here = (stated >= low) & (stated < high)
        share = np.sum((weight * wrong)[here]) / max(np.sum(weight[here]), 1e-9)
        print(f"| {100 * low:.0f} to {100 * min(high, 1):.0f} % | {(here & ~wrong).sum()} | {(here & wrong).sum()} | {100 * share:.0f} % |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=["make", "fit"])
    parser.add_argument("path", type=Path)
    parser.add_argument("surfaces", type=Path, nargs="*")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--shapes", type=int, default=8)
    given = parser.parse_args()
    if given.task == "make":
        make(given.path, given.surfaces, given.seed, given.shapes)
    else:
        fit(json.loads(given.path.read_text()))


if __name__ == "__main__":
    main()
