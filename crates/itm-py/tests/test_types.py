"""The stubs: strict, and in step with what they describe."""

import subprocess
import sys
from pathlib import Path

PACKAGE = Path(__file__).parent.parent


def check(*arguments: object) -> None:
    ran = subprocess.run(
        [sys.executable, "-m", *map(str, arguments)], cwd=PACKAGE, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_tests_and_examples_are_well_typed() -> None:
    check("mypy", "--strict", "python/itm_slam", "tests", "examples", "benchmarks")


def test_the_stubs_are_in_step() -> None:
    check("mypy.stubtest", "itm_slam", "--mypy-config-file", "pyproject.toml")
