"""What Python adds to a frame: the time of a call of process, less what the session itself took.

python overhead.py
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import itm_slam


def added_ms(arguments: Callable[[itm_slam.Frame], tuple[Any, ...]], frames: list[itm_slam.Frame]) -> float:
    """Median over the frames, in milliseconds."""
    session = itm_slam.Session(
        itm_slam.Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5),
        map={"voxel_size_m": 0.02, "truncation_m": 0.08},
    )
    added = []
    for frame in frames:
        given = arguments(frame)
        started = time.perf_counter()
        result = session.process(*given)
        added.append((time.perf_counter() - started) * 1e3 - result.total_ms)
    return statistics.median(added)


def main() -> None:
    frames = list(itm_slam.synth(frames=20))
    ways: dict[str, Callable[[itm_slam.Frame], tuple[Any, ...]]] = {
        "a Frame": lambda f: (f,),
        "float32 depth, HxWx3 colour": lambda f: (f.depth, f.colour, f.timestamp),
        "uint16 depth, HxWx3 colour": lambda f: ((f.depth * 1000).astype("uint16"), f.colour, f.timestamp),
        "every second column of twice as wide images": lambda f: (
            f.depth.repeat(2, axis=1)[:, ::2],
            f.colour.repeat(2, axis=1)[:, ::2] if f.colour is not None else None,
            f.timestamp,
        ),
    }
    for name, arguments in ways.items():
        print(f"{name}: {added_ms(arguments, frames):.2f} ms")


if __name__ == "__main__":
    main()
