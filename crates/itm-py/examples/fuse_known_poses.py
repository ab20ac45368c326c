"""Fuses a recording's frames at the poses that it has, and writes the mesh.

python fuse_known_poses.py path/to/recording mesh.ply
"""

import sys

import itm_slam


def main(path: str, mesh: str) -> None:
    recording = itm_slam.open(path)
    session = itm_slam.Session(recording, poses="given")
    for frame in recording:
        result = session.process(frame)
        if not result.fused:
            print(f"frame {frame.index}: {'; '.join(result.reasons)}")
    session.mesh().save(mesh)


if __name__ == "__main__":
    main(*sys.argv[1:])
