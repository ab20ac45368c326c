"""The loop of a program with a camera of its own; a synthetic one stands in for it here.

python own_camera.py picture.npy
"""

import sys
from collections.abc import Iterator

import itm_slam
import numpy as np
from numpy.typing import NDArray


def camera(
    intrinsics: itm_slam.Intrinsics,
) -> Iterator[tuple[NDArray[np.uint16], NDArray[np.uint8], float]]:
    """Depth in millimetres, colour and time in seconds: what a sensor's own library gives."""
    for frame in itm_slam.synth(camera=intrinsics, frames=10):
        assert frame.colour is not None
        yield np.rint(frame.depth * 1000).astype(np.uint16), frame.colour, frame.seconds


def main(picture: str) -> None:
    intrinsics = itm_slam.Intrinsics(width=160, height=120, fx=131.25, fy=131.25, cx=79.5, cy=59.5)
    session = itm_slam.Session(intrinsics, map={"voxel_size_m": 0.02, "truncation_m": 0.08})
    for depth, colour, seconds in camera(intrinsics):
        result = session.process(depth, colour, seconds)
        if result.pose is not None:
            x, y, z = result.pose[:3, 3]
            print(f"{seconds:.3f} s: {result.status} at {x:.3f}, {y:.3f}, {z:.3f} m")
    np.save(picture, session.render(kind="normals"))


if __name__ == "__main__":
    main(*sys.argv[1:])
