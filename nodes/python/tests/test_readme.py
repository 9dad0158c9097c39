"""The Python of README.md and docs/use/python.md runs."""

import importlib.util
import re

import numpy as np
import pytest
from conftest import ROOT


def blocks(page):
    return re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", ["README.md", "docs/use/python.md"])
def test_the_python_of_a_page_runs(page, monkeypatch, tmp_path):
    # What an example writes goes into another folder.
    for name in ("graphs", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    found = blocks(page)
    assert found, f"{page} has no Python"
    for block in found:
        if "import optuna" in block and importlib.util.find_spec("optuna") is None:
            print(f"skipped: the example of {page} that needs optuna")
            continue
        names = {}
        exec(block, names)
    if page == "README.md":
        # The rows that README.md shows for the command.
        shown = re.search(r"t_target_source, mm\n((?:.*\n){4})", (ROOT / page).read_text()).group(1)
        shown = np.array([[float(cell) for cell in row.split()] for row in shown.splitlines()])
        assert np.abs(names["t"] - shown).max() < 1e-6, "README.md rounds to 6 digits"
