"""Sessions: frames in, poses, pictures, meshes and files out."""

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import itm_slam
from conftest import COARSE, MODES

pytestmark = pytest.mark.gpu


def run(recording: itm_slam.Recording, *settings: Any, **more: Any) -> itm_slam.Session:
    session = itm_slam.Session(recording, *settings, **{**COARSE, **more})
    for frame in recording:
        session.process(frame)
    return session


@pytest.mark.parametrize("mode", MODES)
def test_every_mode_tracks_renders_meshes_saves_and_goes_on(
    mode: str, recording: itm_slam.Recording, tmp_path: Path
) -> None:
    session = itm_slam.Session(recording, COARSE, mode=mode)
    results = [session.process(frame) for frame in recording.frames(0, 8)]
    assert [result.status for result in results] == ["placed"] + 7 * ["tracked"]
    assert all(result.good and result.fused and not result.reasons for result in results)
    assert results[0].pose is not None and np.array_equal(results[0].pose, np.eye(4))
    last = results[-1]
    assert last.verdict == "good" and last.chance_wrong is not None and last.chance_wrong < 0.5
    assert last.covariance is not None and last.covariance.shape == (6, 6)
    assert last.total_ms >= last.track_ms > 0
    assert results[0].report is None and last.report is not None and last.report.index == 5
    assert (last.report.surfels is not None) == ("surfels" in mode)
    assert any(happening.kind == "keyframe" for happening in results[0].happenings)
    truth = recording.ground_truth
    assert truth is not None and itm_slam.evaluate(session.trajectory(), truth).ate.rmse < 0.02

    for kind in ["colour", "grey", "normals", "depth", "confidence"]:
        picture = session.render(kind=kind)  # type: ignore[arg-type]
        assert picture.shape == (120, 160, 4) and picture.dtype == np.uint8
        assert (picture[..., 3] > 0).mean() > 0.5, kind
    camera = itm_slam.Intrinsics(64, 48, 52.5, 52.5, 31.5, 23.5)
    assert session.render(np.eye(4), camera=camera).shape == (48, 64, 4)

    mesh = session.mesh()
    assert mesh.vertices.shape == mesh.normals.shape and mesh.vertices.dtype == np.float32
    assert mesh.faces.dtype == np.uint32 and mesh.faces.max() < len(mesh.vertices)
    assert mesh.colours is not None and mesh.colours.shape == mesh.vertices.shape
    mesh.save(tmp_path / "mesh.ply")
    assert (tmp_path / "mesh.ply").stat().st_size > 1000
    cloud = session.point_cloud()
    assert len(cloud) == len(cloud.points) > 100
    cloud.save(tmp_path / "cloud.pcd")

    session.save(tmp_path / "map.itm")
    resumed = itm_slam.Session.resume(tmp_path / "map.itm")
    assert resumed.frames == 8 and resumed.settings == session.settings
    for frame in recording.frames(8):
        expected, found = session.process(frame).pose, resumed.process(frame).pose
        assert expected is not None and found is not None and np.array_equal(expected, found)
    there = itm_slam.Session.in_map(tmp_path / "map.itm", recording, pose=np.eye(4))
    assert there.process(recording[0]).pose is not None
    found_by_keyframes = itm_slam.Session.in_map(tmp_path / "map.itm", recording, map={"fuse": False})
    assert found_by_keyframes.process(recording[0]).status in ("poor", "tracked", "lost")


def test_arrays_and_frames_give_the_same_poses(recording: itm_slam.Recording) -> None:
    def poses(arrays: Any) -> Any:
        session = itm_slam.Session(recording.calibration, COARSE)
        for frame in recording:
            session.process(*arrays(frame))
        return session.trajectory()

    def wide(image: Any) -> Any:
        """The same image, its values apart in memory."""
        return np.repeat(image, 2, axis=1)[:, ::2]

    def reversed_in_memory(image: Any) -> Any:
        return np.ascontiguousarray(image[::-1])[::-1]

    frames = poses(lambda f: (f.raw_depth, f.colour, f.timestamp))
    assert poses(lambda f: (f.depth, f.colour, f.timestamp)) == frames
    assert poses(lambda f: (wide(f.raw_depth), wide(f.colour), f.timestamp)) == frames
    assert poses(lambda f: (np.asfortranarray(f.depth), reversed_in_memory(f.colour), np.int64(f.timestamp))) == frames
    rgba = poses(lambda f: (f.raw_depth, np.dstack([f.colour, np.full((120, 160), 255, "uint8")]), f.timestamp))
    assert rgba == frames
    grey = poses(lambda f: (f.raw_depth, f.colour[..., 1], f.seconds))
    assert len(grey) == len(recording)


def test_millimetres_are_the_default(recording: itm_slam.Recording) -> None:
    session = itm_slam.Session(recording.calibration.depth, COARSE)
    result = session.process((recording[0].depth * 1000).astype(np.uint16))
    assert result.status == "placed" and result.fused and result.timestamp == 0
    assert session.process((recording[1].depth * 1000).astype(np.uint16)).timestamp == 33333333
    colours = session.mesh().colours
    assert colours is None or not colours.any()


def test_poses_given(recording: itm_slam.Recording) -> None:
    session = itm_slam.Session(recording, COARSE, poses="given")
    for frame in recording:
        result = session.process(frame)
        assert result.status == "placed" and result.pose is not None and frame.pose is not None
        assert np.allclose(result.pose, frame.pose) and result.verdict is None
    placed = itm_slam.Session(recording, COARSE)
    first = recording[0]
    assert first.raw_depth is not None and first.pose is not None
    result = placed.process(first.raw_depth, first.colour, first.timestamp, first.pose)
    assert result.pose is not None and np.allclose(result.pose, first.pose)
    without = itm_slam.Session(recording, COARSE, poses="given").process(first.raw_depth)
    assert without.status == "no-pose" and without.pose is None and without.reasons


def test_wrong_arrays_are_named(recording: itm_slam.Recording) -> None:
    session = itm_slam.Session(recording, COARSE)
    depth, colour = np.zeros((120, 160), np.uint16), np.zeros((120, 160, 3), np.uint8)
    wrong: list[tuple[Any, Any, type[Exception], str]] = [
        (depth.astype(np.float64), None, TypeError, r"uint16 .* float32 .* float64 .*\(120, 160\)"),
        (depth.astype(">u2"), None, TypeError, "depth must be"),
        (depth.tolist(), None, TypeError, "not list"),
        (None, None, TypeError, "not NoneType"),
        (depth[:100], None, ValueError, r"120 rows and 160 columns.*\(100, 160\)"),
        (depth[..., None], None, ValueError, r"\(120, 160, 1\)"),
        (depth, colour.astype(np.float32), TypeError, "colour must be an array of uint8"),
        (depth, colour[:, :, :2], ValueError, r"HxWx3.*\(120, 160, 2\)"),
        (depth, colour[:, :100], ValueError, "colour must have"),
        (depth, colour[0, 0], ValueError, "colour must have"),
        (recording[0], colour, TypeError, "its own colour"),
    ]
    for d, c, error, message in wrong:
        with pytest.raises(error, match=message):
            session.process(d, c)
    for pose, message in [(np.eye(3), "4x4"), (np.full((4, 4), np.nan), "finite"), (np.ones((4, 4)), "last row")]:
        with pytest.raises(ValueError, match=message):
            session.process(depth, pose=pose)
    with pytest.raises(TypeError, match="pose must be a 4x4 matrix"):
        session.process(depth, pose="here")
    for time_, kind in [("now", TypeError), (True, TypeError), (float("nan"), ValueError), (1 << 70, ValueError)]:
        with pytest.raises(kind, match="timestamp"):
            session.process(depth, timestamp=time_)  # type: ignore[arg-type]
    assert session.frames == 0
    assert session.process(depth).status == "no-depth"
    with pytest.raises(ValueError, match="no frame has a pose"):
        session.render()
    with pytest.raises(ValueError, match="kind must be"):
        session.render(np.eye(4), "color")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="max_depth_m"):
        session.render(np.eye(4), max_depth_m=float("nan"))
    with pytest.raises(ValueError, match="up must be"):
        session.mesh().save("mesh.ply", up="x-up")  # type: ignore[arg-type]
    with pytest.raises(itm_slam.ExportError, match="ply"):
        session.mesh().save("mesh.doc")


def test_sessions_that_cannot_be(recording: itm_slam.Recording, tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="calibration must be"):
        itm_slam.Session(3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="poses must be"):
        itm_slam.Session(recording, poses="guessed")  # type: ignore[arg-type]
    with pytest.raises(itm_slam.SettingsError, match="mode"):
        itm_slam.Session(recording, mode="quick")
    with pytest.raises(itm_slam.DeviceError, match="no such adapter as this"):
        itm_slam.Session(recording, device="no such adapter as this")
    with pytest.raises(itm_slam.MapError, match="none.itm"):
        itm_slam.Session.resume(tmp_path / "none.itm")
    (tmp_path / "no.itm").write_text("no map")
    with pytest.raises(itm_slam.MapError, match="not a map file"):
        itm_slam.Session.resume(tmp_path / "no.itm")
    with pytest.raises(itm_slam.MapError, match="not a map file"):
        itm_slam.Session.in_map(tmp_path / "no.itm", recording)
    with pytest.raises(itm_slam.MapError, match="nowhere"):
        run(recording).save(tmp_path / "nowhere" / "map.itm")


def test_distances(recording: itm_slam.Recording) -> None:
    session = run(recording)
    mesh = session.mesh()
    distances = session.distances(mesh.vertices[::50])
    assert distances.dtype == np.float32 and np.nanmax(np.abs(distances)) < 0.02
    assert np.isnan(session.distances([[0, 0, -5]])).all()
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        session.distances([1, 2, 3])


@pytest.mark.parametrize("mode", ["basic", "surfels"])
def test_a_progress_callback_can_end_meshing_and_the_session_goes_on(
    mode: str, recording: itm_slam.Recording
) -> None:
    session = run(recording, mode=mode)
    told: list[tuple[int, int]] = []

    def stop(done: int, of: int) -> None:
        raise InterruptedError("enough")

    with pytest.raises(InterruptedError, match="enough"):
        session.mesh(stop)
    with pytest.raises(RuntimeError, match="within its own progress"):
        session.mesh(lambda done, of: session.frames)
    mesh = session.mesh(lambda done, of: told.append((done, of)))
    assert told and told[-1][0] == told[-1][1]
    assert np.array_equal(mesh.vertices, run(recording, mode=mode).mesh().vertices)


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX has them")
def test_ctrl_c_ends_what_takes_long(tmp_path: Path) -> None:
    def press() -> None:
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=press).start()
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        itm_slam.synth(tmp_path / "long", path="corridor")
    assert not (tmp_path / "long" / "depth.txt").exists()
    # The whole of it takes many minutes.
    assert time.monotonic() - started < 60


def test_other_threads_go_on_while_frames_are_processed(recording: itm_slam.Recording) -> None:
    session = itm_slam.Session(recording, COARSE)
    done = threading.Event()
    turns: list[None] = []

    def count() -> None:
        while not done.is_set():
            turns.append(None)
            time.sleep(0.0005)

    counter = threading.Thread(target=count)
    counter.start()
    before = len(turns)
    for frame in recording:
        session.process(frame)
    during = len(turns) - before
    done.set()
    counter.join()
    assert during > 10

    # Two threads may even share a session: one waits for the other.
    threads = [threading.Thread(target=lambda: session.process(recording[9])) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert session.frames == 13


def test_a_mesh_can_be_worked_on(recording: itm_slam.Recording) -> None:
    mesh = run(recording).mesh()
    fewer = mesh.decimate(0.5)
    assert 0 < len(fewer.faces) < 0.7 * len(mesh.faces)
    assert len(mesh.without_small_pieces(50).faces) <= len(mesh.faces)
    middle = np.median(mesh.vertices, axis=0)
    cropped = mesh.crop(middle - 0.5, middle + 0.5)
    assert 0 < len(cropped.faces) < len(mesh.faces)
    assert np.abs(cropped.vertices - middle).max() <= 0.5001
    with pytest.raises(ValueError):
        mesh.decimate(2.0)


def test_adapters() -> None:
    adapters = itm_slam.adapters()
    assert adapters and all(adapter.name for adapter in adapters)
