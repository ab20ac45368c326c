"""`python -m itm_slam` is the program, and makes the same bytes as the package."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import itm_slam
from conftest import COARSE, MODES


def itm(*arguments: object, cwd: Path) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "itm_slam", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True)


def test_it_is_the_program(tmp_path: Path) -> None:
    found = itm("--version", cwd=tmp_path)
    assert (found.returncode, found.stdout) == (0, f"itm {itm_slam.__version__}\n")
    assert itm("run", cwd=tmp_path).returncode == 2
    failed = itm("run", "nowhere", cwd=tmp_path)
    assert failed.returncode == 1 and "'nowhere' does not exist" in failed.stderr


@pytest.mark.gpu
@pytest.mark.parametrize(
    ("mode", "poses"), [*((mode, "tracked") for mode in MODES), ("basic", "given"), ("surfels", "given")]
)
def test_the_same_bytes(mode: str, poses: Any, room: Path, tmp_path: Path) -> None:
    size = ["--set", "map.voxel_size_m=0.02", "--set", "map.truncation_m=0.08"]
    ran = itm(
        *("run", room, "-o", "out", "--save", "program.itm", "--no-mesh", "--quiet"),
        *("--mode", mode, "--poses", poses, *size),
        cwd=tmp_path,
    )
    assert ran.returncode == 0, ran.stderr
    recording = itm_slam.open(room)
    session = itm_slam.Session(recording, COARSE, mode=mode, poses=poses)
    for frame in recording:
        session.process(frame)
    session.finish()
    session.save(tmp_path / "package.itm")
    session.settle()
    session.trajectory().save(tmp_path / "package.txt")
    assert (tmp_path / "package.txt").read_bytes() == (tmp_path / "out" / "trajectory.txt").read_bytes()
    assert (tmp_path / "package.itm").read_bytes() == (tmp_path / "program.itm").read_bytes()


@pytest.mark.gpu
@pytest.mark.skipif("ITM_PROGRAM" not in os.environ, reason="ITM_PROGRAM does not say where the program is")
@pytest.mark.parametrize("mode", MODES)
def test_the_same_bytes_as_the_program_without_python(mode: str, room: Path, tmp_path: Path) -> None:
    arguments = ["run", str(room), "--save", "map.itm", "--quiet", "--mode", mode]
    arguments += ["--set", "map.voxel_size_m=0.02", "--set", "map.truncation_m=0.08"]
    for out, program in (("native", [os.environ["ITM_PROGRAM"]]), ("python", [sys.executable, "-m", "itm_slam"])):
        (tmp_path / out).mkdir()
        ran = subprocess.run([*program, *arguments, "-o", "."], cwd=tmp_path / out, capture_output=True, text=True)
        assert ran.returncode == 0, ran.stderr
    for name in ("trajectory.txt", "map.itm", "mesh.ply"):
        native, python = ((tmp_path / out / name).read_bytes() for out in ("native", "python"))
        assert native == python, name
