"""`view`: what the page shows is what was registered or run. The page in a notebook itself is driven by tests/viewer_notebook.rs."""

import json
import time
import urllib.request

import numpy as np
import osteoflow
import pytest
from conftest import TWO_FILES
from osteoflow import _view

ORIGIN = "http://127.0.0.1:8888"


def again(fit, folder):
    """The registration that the page makes of what `register` has returned, as the command would."""
    (bone, scan), sets = _view._registered(fit, folder)
    files = osteoflow._core.setting_texts({"bone.path": str(bone), "scan.path": str(scan)})
    return osteoflow.Graph(TWO_FILES).run(set=[*files, *sets], wires=["icp.t_target_source"], progress=False, record=False)


def pose(run):
    return run["icp.t_target_source"].array


@pytest.fixture(scope="module")
def points(files, tmp_path_factory):
    """Points on the bone and where the true pose has them in the scan, a millimetre off."""
    fit = osteoflow.register(files / "bone.stl", files / "scan.ply", progress=False)
    scan = osteoflow.read(files / "scan.ply").points[::1500] + 0.5
    bone = scan @ fit.t_target_source[:3, :3].T + fit.t_target_source[:3, 3] + 0.5
    folder = tmp_path_factory.mktemp("points")
    for name, places in (("bone", bone), ("scan", scan)):
        rows = [f"P{k},{x},{y},{z}" for k, (x, y, z) in enumerate(places)]
        (folder / f"{name}.csv").write_text("\n".join(["label,x,y,z", *rows]) + "\n")
    return folder / "bone.csv", folder / "scan.csv"


@pytest.mark.parametrize("options", [{}, {"method": "symmetric", "camera": [0, 0, 0], "set": {"trim_fraction": 0.1}}, {"sphere": [0, 0, 205, 40]}, {"require": "doubtful", "max_points": 4000, "seed": 5}])
def test_a_registration_is_shown_with_its_bits(files, tmp_path, options):
    fit = osteoflow.register(files / "bone.stl", files / "scan.ply", progress=False, **options)
    shown = again(fit, tmp_path)
    assert pose(shown).tobytes() == fit.t_target_source.tobytes()
    assert shown.results["verdict"]["reasons"] == fit.verdict["reasons"]


def test_one_from_landmarks_is_shown_with_its_bits(files, tmp_path, points):
    fit = osteoflow.register(files / "bone.stl", files / "scan.ply", landmarks=points, progress=False)
    assert pose(again(fit, tmp_path)).tobytes() == fit.t_target_source.tobytes()


def test_one_from_a_pose_is_shown_from_that_pose_and_not_by_shape(files, tmp_path):
    fit = osteoflow.register(files / "bone.stl", files / "scan.ply", progress=False)
    start = fit.t_target_source.copy()
    # Turned half around its long axis: from there another minimum is found, which one by shape would not find.
    scan = osteoflow.read(files / "scan.ply").points
    moved = scan @ start[:3, :3].T + start[:3, 3]
    middle = moved.mean(axis=0)
    axis = np.linalg.svd(moved - middle, full_matrices=False)[2][0]
    half = 2.0 * np.outer(axis, axis) - np.eye(3)
    start[:3, :3], start[:3, 3] = half @ start[:3, :3], half @ (start[:3, 3] - middle) + middle
    try:
        other = osteoflow.register(files / "bone.stl", files / "scan.ply", start, progress=False)
    except osteoflow.Refused as refused:
        pytest.skip(f"refused from there: {refused}")
    assert np.abs(other.t_target_source - fit.t_target_source).max() > 0.5
    shown = pose(again(other, tmp_path))
    assert np.abs(shown - other.t_target_source).max() < 1e-6, "the start is that of four points, to the last digits"


def test_what_is_in_memory_is_shown_as_it_was_registered(files, tmp_path):
    scan = osteoflow.read(files / "scan.ply")
    fit = osteoflow.register(files / "bone.stl", scan.points[::2].copy(), progress=False)
    assert pose(again(fit, tmp_path)).tobytes() == fit.t_target_source.tobytes()


def test_one_that_was_not_returned_by_register_is_refused(files):
    fit = osteoflow.register(files / "bone.stl", files / "scan.ply", progress=False)
    with pytest.raises(osteoflow.UsageError, match="does not know its files"):
        osteoflow.view(osteoflow.Registration(fit.report))
    with pytest.raises(osteoflow.UsageError, match="has its scan"):
        osteoflow.view(fit, files / "scan.ply")


def served(widget, results=None):
    """The page of a widget, once its notebook has said its address; and the results of the run that it shows."""
    try:
        widget._take(None, {"origin": ORIGIN}, None)
        assert not widget.problem, widget.problem
        with urllib.request.urlopen(widget.address, timeout=60) as answer:
            assert ORIGIN in answer.headers["Content-Security-Policy"]
            page = answer.read().decode()
        until = time.monotonic() + 120
        while results is not None and not results.exists():
            assert time.monotonic() < until, f"{results} does not come"
            time.sleep(0.05)
        return page, None if results is None else json.loads(results.read_text())
    finally:
        widget.close()


def test_a_registration_a_run_and_a_graph_with_settings_are_served(files, tmp_path):
    pytest.importorskip("anywidget")
    fit = osteoflow.register(files / "bone.stl", files / "scan.ply", method="symmetric", progress=False)
    page, results = served(osteoflow.view(fit, out=tmp_path / "fit", picks=tmp_path / "picks"), tmp_path / "fit/results.json")
    assert "<html" in page
    shown = results["poses"]["t_ct_camera"]["matrix"] if "matrix" in results["poses"]["t_ct_camera"] else results["poses"]["t_ct_camera"]
    assert np.abs(np.array(shown, float).reshape(4, 4) - fit.t_target_source).max() < 1e-9

    ran = osteoflow.Graph(TWO_FILES).run(out=tmp_path / "run", progress=False)
    page, _ = served(osteoflow.view(ran, picks=tmp_path / "picks"))
    assert "<html" in page
    with pytest.raises(osteoflow.UsageError, match="wrote no files"):
        osteoflow.view(osteoflow.Graph(TWO_FILES).run(progress=False))

    widget = osteoflow.view(TWO_FILES, set={"icp.kind": "icp.symmetric"}, out=tmp_path / "graph", picks=tmp_path / "picks")
    page, results = served(widget, tmp_path / "graph/results.json")
    assert results["verdict"]["answer"] == "trusted"
    manifest = json.loads((tmp_path / "graph/manifest.json").read_text())
    assert "icp.symmetric" in json.dumps(manifest), "the setting is not that of the run"
