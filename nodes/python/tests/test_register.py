"""`register`, `read` and `write`: the bits and words of the command."""

import json
import os
import signal
import threading
import time

import numpy as np
import osteoflow
import pytest

#: Entries of the report that are times, or say which program and file it was.
OF_THE_CALL = {"command", "load", "load_ms", "target", "source", "init", "start", "notes"}


def same(report, told):
    """Compares a report with the command's JSON, without times and what names program and files."""
    def plain(answer):
        return {k: v for k, v in answer.items() if k not in OF_THE_CALL and not k.endswith("_ms") or k in ("rms_mm",)}

    assert list(report) == list(told)
    assert plain(report) == plain(told)


@pytest.fixture(scope="module")
def fit(files):
    """The registration of two files."""
    return osteoflow.register(files / "bone.stl", files / "scan.ply")


def test_the_error_is_predicted_at_targets_as_the_command_does(files, fit, command_json, tmp_path):
    points = tmp_path / "targets.csv"
    points.write_text("label,x,y,z\nnear,0,0,-900\nfar,0,200,-900\n")
    here = osteoflow.register(files / "bone.stl", files / "scan.ply", targets=points)
    told = command_json("register", files / "bone.stl", files / "scan.ply", "--targets", points)
    assert here.t_target_source.tobytes() == fit.t_target_source.tobytes()
    assert here.verdict == told["verdict"] and [p["name"] for p in here.verdict["predicted"]["points"]] == ["near", "far"]


def test_two_files_give_the_bits_verdict_and_report_of_the_command(files, fit, command_json):
    told = command_json("register", files / "bone.stl", files / "scan.ply")
    assert fit.t_target_source.tobytes() == np.array(told["T"]).tobytes()
    assert fit.verdict == told["verdict"]
    same(fit.report, told)
    assert fit.n_pairs == told["n_pairs"] and fit.workers == os.cpu_count()
    with pytest.raises(AttributeError, match="no 'pairs'"):
        _ = fit.pairs


@pytest.mark.parametrize("method", ["point_to_plane", "point_to_point", "symmetric", "generalized", "point_to_mesh", "published"])
def test_every_method_gives_the_bits_of_the_command_from_what_read_gives(files, fit, command_json, tmp_path, method):
    bone, scan = osteoflow.read(files / "bone.stl"), osteoflow.read(files / "scan.ply")
    start = fit.t_target_source
    osteoflow.write(tmp_path / "init.txt", start)
    # The paper does not say which rule it stopped by, so it has no default.
    settings = {"reading": "iterations"} if method == "published" else {}
    sets = [word for key in settings for word in ("--set", f"{key}={settings[key]}")]
    files = [files / "bone.stl", files / "scan.ply"]
    told = command_json("register", *files, "--method", method, "--init", tmp_path / "init.txt", "--workers", 1, *sets)
    ours = osteoflow.register(bone, scan, start, method, set=settings, workers=2)
    assert ours.t_target_source.tobytes() == np.array(told["T"]).tobytes()
    assert ours.verdict == told["verdict"]
    assert ours.report["report"] == told["report"]


def test_arrays_of_any_layout_give_the_same_bits_and_only_others_are_copied(files, command_json, tmp_path):
    bone, scan = osteoflow.read(files / "bone.stl"), osteoflow.read(files / "scan.ply")
    rng = np.random.default_rng(1)
    target = bone.vertices[rng.permutation(len(bone.vertices))[:20_000]].copy()
    osteoflow.write(tmp_path / "target.csv", target)
    told = command_json("register", tmp_path / "target.csv", files / "scan.ply")
    expected = np.array(told["T"]).tobytes()
    scans = [scan, scan.points, np.asfortranarray(scan.points), np.repeat(scan.points, 2, axis=0)[::2], scan.points.tolist()]
    for given in scans:
        fit = osteoflow.register(target, given)
        assert fit.t_target_source.tobytes() == expected
        assert fit.verdict == told["verdict"]
    assert osteoflow.Cloud(target).points is target
    assert np.shares_memory(osteoflow.Cloud(np.asfortranarray(target)).points, target) is False
    # The arrays are not held after the call: they can be resized.
    own = scan.points.copy()
    osteoflow.register(target, own)
    own.resize((10, 3), refcheck=False)


def test_options_have_the_words_of_the_command_and_its_errors_too(files, command):
    def said(*arguments):
        text = command("register", *arguments).stderr
        return text.split(": ", 1)[1].split("\n\nUsage:")[0].strip()

    bone, scan = files / "bone.stl", files / "scan.ply"
    with pytest.raises(osteoflow.UsageError) as raised:
        osteoflow.register(bone, scan, method="nearest")
    known = str(raised.value).removeprefix('method "nearest" is none of ')
    assert f"[possible values: {known}]" in said(bone, scan, "--method=nearest"), str(raised.value)
    with pytest.raises(osteoflow.UsageError) as raised:
        osteoflow.register(bone, scan, set={"trim_fractions": 0.2})
    assert "trim_fractions" in str(raised.value) and "did you mean" in str(raised.value), str(raised.value)
    with pytest.raises(osteoflow.OsteoflowError) as raised:
        osteoflow.register(bone, files / "none.ply")
    assert str(raised.value) == said(bone, files / "none.ply")
    with pytest.raises(osteoflow.Refused) as raised:
        osteoflow.register(bone, scan, np.eye(4), max_pair_distance_mm=1e-3)
    assert str(raised.value) == said(bone, scan, "--init=identity", "--max-pair-distance-mm=0.001").splitlines()[0].removeprefix("refused: ")
    assert raised.value.report["verdict"]["answer"] == "refused"


def test_parts_and_regions_are_those_of_the_command(files, fit, command_json, tmp_path):
    start = tmp_path / "start.txt"
    np.savetxt(start, fit.t_target_source)
    scan = osteoflow.read(files / "scan.ply")
    low, high = scan.points.min(axis=0), scan.points.max(axis=0)
    away = scan.points[:500] + (high - low) * [3.0, 0.0, 0.0]
    osteoflow.write(tmp_path / "around.ply", osteoflow.Cloud(np.vstack([scan.points, away])))
    box = [*(low - 1.0), *(high + 1.0)]
    sphere = [*((low + high) / 2.0), float(np.linalg.norm(high - low))]
    region = tmp_path / "region.json"
    shape = {"shape": "box", "min": box[:3], "max": box[3:]}
    region.write_text(json.dumps({"format": "osteoflow-region", "version": 1, "units": "mm", "frame": "camera", "keep": [shape]}))
    bone, around = files / "bone.stl", tmp_path / "around.ply"
    commas = lambda numbers: ",".join(repr(float(number)) for number in numbers)
    for options, words in [
        (dict(box=box), [f"--box={commas(box)}"]),
        (dict(sphere=sphere), [f"--sphere={commas(sphere)}"]),
        (dict(region=region), [f"--region={region}"]),
        (dict(source_component=1), ["--source-component=1"]),
        (dict(source_component="largest", component=1), ["--source-component=largest", "--component=1"]),
    ]:
        told = command_json("register", bone, around, f"--init={start}", "--no-verdict", *words)
        ours = osteoflow.register(bone, around, start, verdict=False, **options)
        assert ours.t_target_source.tobytes() == np.array(told["T"]).tobytes(), options
        assert ours.report["notes"] == told["notes"], options
        n = ours.report["report"]["n_source"]
        assert n <= len(scan.points), f"{n} points of {options}"
        # Of what was read the same part is taken.
        ours = osteoflow.register(bone, osteoflow.read(around), start, verdict=False, **options)
        assert ours.report["report"]["n_source"] == n, options
    with pytest.raises(osteoflow.UsageError, match="corners with a coordinate in common"):
        osteoflow.register(bone, around, box=[0, 0, 0, 1, 0, 1])
    with pytest.raises((osteoflow.UsageError, osteoflow.OsteoflowError), match="radius"):
        osteoflow.register(bone, around, sphere=[0, 0, 0, -1])
    with pytest.raises(osteoflow.UsageError, match="names no part"):
        osteoflow.register(bone, osteoflow.read(around), source_component="smallest")


def test_what_is_wrong_with_an_array_is_said(files):
    bone = osteoflow.read(files / "bone.stl")
    points = osteoflow.read(files / "scan.ply").points.copy()
    with pytest.raises(ValueError, match=r"points has shape \(4000, 2\), but must be \(n, 3\)|shape"):
        osteoflow.register(bone, points[:, :2])
    with pytest.raises(ValueError, match="points has 3 masked values"):
        osteoflow.register(bone, np.ma.masked_array(points, np.arange(len(points))[:, None] * np.ones((1, 3)) == 7))
    with pytest.raises(ValueError, match="points holds complex128, but must be real numbers"):
        osteoflow.register(bone, points + 0j)
    points[7, 1] = np.nan
    with pytest.raises(ValueError, match="point 7 is not finite.*isfinite"):
        osteoflow.register(bone, points)
    with pytest.raises(ValueError, match="init"):
        osteoflow.register(bone, points[8:], np.diag([1.0, 1.0, 2.0, 1.0]))
    with pytest.raises(osteoflow.UsageError, match="must be in mm"):
        osteoflow.register(bone, points[8:], unit_mm=1000)
    with pytest.raises(osteoflow.UsageError, match="finite|number"):
        osteoflow.register(bone, points[8:], max_pair_distance_mm=float("nan"))


def test_files_are_read_and_written_in_every_format(files, fit, tmp_path):
    bone, scan = osteoflow.read(files / "bone.stl"), osteoflow.read(files / "scan.ply")
    assert bone.vertices.dtype == np.float64 and bone.faces.dtype == np.uint32 and bone.faces.shape[1] == 3
    for ending in ["ply", "stl", "obj"]:
        osteoflow.write(tmp_path / f"bone.{ending}", bone)
        back = osteoflow.read(tmp_path / f"bone.{ending}")
        assert back.faces.shape == bone.faces.shape
        assert np.abs(back.vertices[back.faces] - bone.vertices[bone.faces]).max() < 1e-4, "STL has single precision"
    for ending in ["ply", "pcd", "vtk", "obj", "csv"]:
        osteoflow.write(tmp_path / f"scan.{ending}", scan)
        back = osteoflow.read(tmp_path / f"scan.{ending}")
        assert np.abs(back.points - scan.points).max() < 1e-4, ending
    points = {"P1": np.array([1.0, 2.0, 3.0]), "P2": np.array([4.0, 5.0, 6.0])}
    for ending in ["mrk.json", "fcsv", "csv"]:
        osteoflow.write(tmp_path / f"picked.{ending}", points, space="LPS")
        back = osteoflow.read(tmp_path / f"picked.{ending}")
        assert {name: xyz.tolist() for name, xyz in back.items()} == {k: v.tolist() for k, v in points.items()}
    pose = fit.t_target_source
    for ending in ["txt", "json"]:
        osteoflow.write(tmp_path / f"pose.{ending}", pose)
        assert np.abs(osteoflow.read(tmp_path / f"pose.{ending}") - pose).max() < 1e-12
    osteoflow.write(tmp_path / "pose.tfm", pose)
    with pytest.warns(osteoflow.OsteoflowWarning, match="its inverse is taken"):
        assert np.abs(osteoflow.read(tmp_path / "pose.tfm") - pose).max() < 1e-9
    with pytest.raises(osteoflow.UsageError, match="exists already"):
        osteoflow.write(tmp_path / "pose.txt", pose)
    with pytest.raises(osteoflow.UsageError, match="claims a space"):
        osteoflow.write(tmp_path / "other.fcsv", points)
    with pytest.raises(osteoflow.OsteoflowError, match="none.ply: cannot be read"):
        osteoflow.read(tmp_path / "none.ply")


def test_ctrl_c_stops_a_registration_as_a_keyboard_interrupt(files):
    bone, scan = osteoflow.read(files / "bone.stl"), osteoflow.read(files / "scan.ply")
    started = time.monotonic()
    press = threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT))
    press.start()
    with pytest.raises(KeyboardInterrupt):
        osteoflow.register(bone, scan, repeat=100_000, progress=False)
    assert time.monotonic() - started < 30


def test_the_gil_is_released(files):
    bone, scan = osteoflow.read(files / "bone.stl"), osteoflow.read(files / "scan.ply")
    done = threading.Event()

    def work():
        osteoflow.register(bone, scan, repeat=5)
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    n = 0
    while not done.is_set():
        n += 1
        time.sleep(0.001)
    thread.join()
    assert n > 20, f"the main thread got {n} turns"


def test_stubs_and_docstrings_are_there():
    from importlib.resources import files as resources

    package = resources("osteoflow")
    assert (package / "py.typed").is_file() and (package / "_core.pyi").is_file()
    for name in osteoflow.__all__:
        if name != "__version__":
            assert getattr(osteoflow, name).__doc__, name
    assert json.loads(json.dumps(osteoflow.__version__)) == "0.2.0"


def sphere_in_a_ct(file, spacing_mm=0.8, radius_mm=12.0, centre_ras_mm=(10.0, -20.0, 30.0)):
    """Writes a CT as NIfTI-1: a sphere of bone, 1000 HU, in soft tissue, 40 HU, in air; edges are 1.6 mm wide."""
    import struct

    n = 48
    corner = [c - spacing_mm * n / 2 for c in centre_ras_mm]
    axis = [corner[k] + spacing_mm * np.arange(n) - centre_ras_mm[k] for k in range(3)]
    r = np.sqrt(axis[0][None, None, :] ** 2 + axis[1][None, :, None] ** 2 + axis[2][:, None, None] ** 2)
    hu = 40.0 + 960.0 * np.clip(0.5 + (radius_mm - r) / 1.6, 0.0, 1.0)
    hu -= 1040.0 * np.clip(0.5 + (r - radius_mm - 5.0) / 1.6, 0.0, 1.0)
    header = bytearray(352)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, 3, n, n, n, 1, 1, 1, 1)
    struct.pack_into("<2h", header, 70, 4, 16)
    struct.pack_into("<8f", header, 76, 1.0, spacing_mm, spacing_mm, spacing_mm, 0, 0, 0, 0)
    struct.pack_into("<3f", header, 108, 352.0, 1.0, 0.0)
    header[123] = 2  # mm
    struct.pack_into("<h", header, 254, 1)
    for row, offset in enumerate((280, 296, 312)):
        numbers = [0.0, 0.0, 0.0, corner[row]]
        numbers[row] = spacing_mm
        struct.pack_into("<4f", header, offset, *numbers)
    header[344:348] = b"n+1\0"
    file.write_bytes(bytes(header) + hu.astype("<i2").tobytes())


def test_a_ct_gives_the_surface_of_the_bone_in_lps(command, command_json, files, tmp_path):
    ct = tmp_path / "ct.nii"
    sphere_in_a_ct(ct)
    bone = osteoflow.read(ct)
    assert isinstance(bone, osteoflow.Mesh) and bone.space == "LPS" and len(bone.faces) > 1000
    off = np.linalg.norm(bone.vertices - [-10.0, 20.0, 30.0], axis=1) - 12.0
    assert np.abs(off).max() < 0.1, f"{np.abs(off).max()} mm off a sphere on a grid of 0.8 mm"
    # A higher threshold is further in: an edge is 960 HU in 1.6 mm.
    higher = osteoflow.read(ct, threshold_hu=760.0)
    moved = np.linalg.norm(higher.vertices - [-10.0, 20.0, 30.0], axis=1).mean() - 12.0
    assert abs(moved + 0.4) < 0.05, f"{moved} mm"
    # The same surface as the command's.
    ended = command("convert", ct, tmp_path / "bone.ply", "--iso-hu", 760)
    assert ended.returncode == 0, ended.stderr
    told = osteoflow.read(tmp_path / "bone.ply")
    assert len(told.faces) == len(higher.faces) and np.abs(told.vertices - higher.vertices).max() < 1e-4
    # Registered as a file and as what was read.
    scan = higher.vertices[higher.vertices[:, 2] > 32.0][::2] + [0.5, 0.0, 0.0]
    told = command_json("register", ct, tmp_path / "bone.ply", "--init", "identity", "--threshold-hu", 760, "--no-verdict")
    fit = osteoflow.register(ct, tmp_path / "bone.ply", "identity", threshold_hu=760.0, verdict=False)
    assert fit.t_target_source.tobytes() == np.array(told["T"]).tobytes()
    assert osteoflow.register(higher, scan, "identity", verdict=False).rms_mm < 0.1
    with pytest.raises(osteoflow.UsageError, match="threshold_hu|CT"):
        osteoflow.read(files / "bone.stl", threshold_hu=760.0)
    with pytest.raises(osteoflow.OsteoflowError):
        osteoflow.read(ct, threshold_hu=5000.0)
    broken = tmp_path / "broken.nii"
    broken.write_bytes(ct.read_bytes()[:-1000])
    with pytest.raises(osteoflow.OsteoflowError, match="broken.nii"):
        osteoflow.read(broken)
