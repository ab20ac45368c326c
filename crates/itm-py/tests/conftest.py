"""What several tests use. All that make a Session need a graphics adapter, be it a software one."""

import os
from pathlib import Path
from typing import Any

import pytest

import itm_slam

# Coarse, so that a software driver takes no time.
COARSE: dict[str, Any] = {"map": {"voxel_size_m": 0.02, "truncation_m": 0.08}}

MODES = ["basic", "loop-closure", "surfels", "surfels-loop-closure"]


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small recording."""
    folder = tmp_path_factory.mktemp("recordings") / "room"
    itm_slam.synth(folder, frames=10, size=(160, 120))
    return folder


@pytest.fixture(scope="session")
def recording(room: Path) -> itm_slam.Recording:
    return itm_slam.open(room)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if "ITM_SKIP_GPU_TESTS" in os.environ:
        for item in items:
            if "gpu" in item.keywords:
                item.add_marker(pytest.mark.skip(reason="ITM_SKIP_GPU_TESTS is set"))
