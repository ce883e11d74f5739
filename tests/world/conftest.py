"""What tests of worlds share."""

import shutil
import subprocess
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def oracle(tmp_path_factory):
    """The real parser, compiled from the few lines beside this file."""
    if not (shutil.which("g++") and shutil.which("pkg-config")):
        pytest.skip("no g++ and pkg-config")
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "sdformat12"], capture_output=True, text=True, check=False
    )
    if flags.returncode:
        pytest.skip("libsdformat-dev (sdformat12) is not installed")
    program = tmp_path_factory.mktemp("oracle") / "sdformat_oracle"
    source = Path(__file__).with_name("sdformat_oracle.cpp")
    subprocess.run(["g++", "-O0", source, "-o", program, *flags.stdout.split()], check=True)
    return program
