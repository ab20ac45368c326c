"""The examples run, where the packages that they use are there."""

import subprocess
import sys
from pathlib import Path

import pytest

import itm_slam
from conftest import COARSE

EXAMPLES = Path(__file__).parent.parent / "examples"

pytestmark = pytest.mark.gpu


def example(name: str, *arguments: object) -> str:
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), *map(str, arguments)]
    ran = subprocess.run(command, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def test_known_poses_are_fused(room: Path, tmp_path: Path) -> None:
    assert example("fuse_known_poses", room, tmp_path / "mesh.ply") == ""
    assert (tmp_path / "mesh.ply").stat().st_size > 10_000


def test_a_recording_is_tracked(room: Path, tmp_path: Path) -> None:
    said = example("track_recording", room, tmp_path / "trajectory.txt")
    assert "10 of 10 frames have a pose" in said and "ATE" in said


def test_a_camera_of_ones_own(tmp_path: Path) -> None:
    said = example("own_camera", tmp_path / "picture.npy")
    assert said.count("tracked at") == 9


def test_a_mesh_for_trimesh(recording: itm_slam.Recording, tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    session = itm_slam.Session(recording, COARSE)
    for frame in recording:
        session.process(frame)
    session.save(tmp_path / "map.itm")
    assert "faces" in example("mesh_to_trimesh", tmp_path / "map.itm")
