"""Shows one run in CloudCompare, Rerun and the project's own page, at its end, and keeps the pictures in docs/clients/.

    target/clients/bin/python tests/clients/screenshots.py

It needs the clients that `tests/clients/install` installs, and of Debian chromium, xvfb, imagemagick and mesa-vulkan-drivers.
All three have to show the scan in its colours on the same side of the same bone: that is for an eye to see.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from client import ROOT, folder, recorded, run
from streams import Served

OUT = ROOT / "docs" / "clients"
SIZE = (1000, 750)


def on_screen(name, script, seconds=120):
    """The picture of a screen after a shell script has drawn on it."""
    OUT.mkdir(exist_ok=True)
    picture = OUT / f"{name}.png"
    text = f"{script}\nimport -window root -colors 192 {picture}\nkill $window 2> /dev/null\n"
    screen = f"-screen 0 {SIZE[0]}x{SIZE[1]}x24"
    home = {**os.environ, "HOME": str(folder()), "XDG_RUNTIME_DIR": str(folder()), "LIBGL_ALWAYS_SOFTWARE": "1"}
    done = subprocess.run(["xvfb-run", "-a", "-s", screen, "bash", "-c", text], capture_output=True, text=True, timeout=seconds, env=home)
    if not picture.exists():
        sys.exit(f"{name}: no picture: {done.stdout[-800:]}{done.stderr[-800:]}")
    print(f"{picture.relative_to(ROOT)}: {picture.stat().st_size // 1024} kB")


def cloudcompare():
    export, names = recorded() / "export", []
    for what, name in [("C", "scan.ply"), ("M", "bone.stl")]:
        copy = folder() / name
        shutil.copy(export / name, copy)
        save = "-SAVE_CLOUDS" if what == "C" else "-SAVE_MESHES"
        quiet = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
        options = ["-SILENT", "-NO_TIMESTAMP", "-AUTO_SAVE", "OFF", f"-{what}_EXPORT_FMT", "BIN"]
        # It looks along -z: the bone is laid across the screen, with its scanned side to the front.
        lay = folder() / "lay.txt"
        lay.write_text("0 0 1 0\n0 1 0 0\n-1 0 0 0\n0 0 0 1\n")
        run("xvfb-run", "-a", "CloudCompare", *options, "-O", copy, "-APPLY_TRANS", lay, save, env=quiet)
        # Opened from its own format it asks no questions.
        names.append(str(copy.with_suffix(".bin")))
    on_screen("cloudcompare", f"CloudCompare {' '.join(names)} & window=$!; sleep 20")


def rerun():
    import rerun as rr
    import rerun.blueprint as rrb
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    reader = vtk.vtkSTLReader()
    reader.SetFileName(str(recorded() / "export" / "bone.stl"))
    reader.Update()
    bone = reader.GetOutput()
    vertices = vtk_to_numpy(bone.GetPoints().GetData()) / 1000
    faces = vtk_to_numpy(bone.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    shown = folder() / "shown.rrd"
    recording = rr.RecordingStream("osteoflow")
    recording.save(shown)
    recording.log_file_from_path(recorded() / "run.mcap")
    # It draws no foxglove.SceneUpdate, so the bone comes from its file.
    mesh = rr.Mesh3D(vertex_positions=vertices.astype(np.float32), triangle_indices=faces, albedo_factor=[227, 217, 191])
    recording.log("bone", mesh, rr.CoordinateFrame("ct"), static=True)
    view = rrb.Spatial3DView(
        origin="/", contents=["/bone", "/run/registered"], spatial_information=rrb.SpatialInformation(target_frame="ct")
    )
    time = rrb.TimePanel(timeline="message_log_time", play_state="following", state="collapsed")
    recording.send_blueprint(rrb.Blueprint(view, time, rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden")))
    recording.flush()
    command = Path(sys.executable).with_name("rerun")
    size = f"{SIZE[0]}x{SIZE[1]}"
    picture = folder() / "rerun.png"
    show = f"{command} {shown} --screenshot-to {picture} --window-size {size} --renderer vulkan --port 0"
    on_screen("rerun", f"{show}; import() {{ convert {picture} -resize {SIZE[0]}x -colors 192 {OUT / 'rerun.png'}; }}", 200)


def page():
    with Served("view", recorded()) as served:
        browser = "chromium --no-sandbox --no-first-run --disable-background-networking --disable-component-update --disable-sync"
        size = f"--window-size={SIZE[0]},{SIZE[1]} --window-position=0,0 --user-data-dir={folder()}/chromium"
        on_screen("page", f"{browser} {size} --test-type --use-angle=swiftshader --enable-unsafe-swiftshader --app={served.page} & window=$!; sleep 25")


if __name__ == "__main__":
    cloudcompare()
    rerun()
    page()
