"""The Python of README.md and docs/use/python.md runs."""

import re

import numpy as np
import pytest
from conftest import ROOT


def blocks(page):
    return re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", ["README.md", "docs/use/python.md"])
def test_the_python_of_a_page_runs(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    found = blocks(page)
    assert found, f"{page} has no Python"
    for block in found:
        names = {}
        exec(block, names)
    if page == "README.md":
        # The rows that README.md shows for the command.
        shown = re.search(r"t_target_source, mm\n((?:.*\n){4})", (ROOT / page).read_text()).group(1)
        shown = np.array([[float(cell) for cell in row.split()] for row in shown.splitlines()])
        assert np.abs(names["t"] - shown).max() < 1e-6, "README.md rounds to 6 digits"
