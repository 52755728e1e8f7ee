"""The Rerun viewer as a program of its own."""

import os
import shutil
import subprocess
import sys
from pathlib import Path


def open_viewer(recording: Path) -> bool:
    """Open a recording and leave the viewer running; False where there is no display or no viewer.

    The viewer listens on loopback only.
    """
    beside_python = str(Path(sys.executable).parent)
    program = shutil.which("rerun", path=os.pathsep.join([beside_python, os.environ.get("PATH", "")]))
    if program is None or not _has_display():
        return False
    subprocess.Popen(
        [program, str(recording), "--bind", "127.0.0.1", "--port", "auto"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    return True


def _has_display() -> bool:
    graphical = sys.platform in ("win32", "darwin")
    return graphical or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
