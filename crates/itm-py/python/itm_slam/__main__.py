"""The program itm."""

import signal
import sys

from ._native import main as run


def main() -> int:
    """Run the program with this process's arguments; its exit status."""
    # Python only notes Ctrl-C until its own code runs again, which it does not before the program's end. The program has its
    # own way to stop where there is something to keep.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return run(["itm", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
