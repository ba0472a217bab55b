"""Packaging beyond pyproject.toml: pymavlink's messages, and kernels.

A wheel carries the one module of messages that the link needs, as pymavlink has generated it (generated code is under
the MIT licence): the package with all its dialects and what it requires takes 108 MB. $ALULA_KERNELS names a folder
of `export.prebuilt` that the wheel carries as well; it is then for their machine alone, else for any.
"""

import atexit
import os
import shutil
import tempfile
from importlib import metadata, util
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build import build
from setuptools.command.build_py import build_py

KERNELS = os.environ.get("ALULA_KERNELS", "")


DIALECT = "pymavlink/dialects/v20/development.py"


class BuildElsewhere(build):
    """Builds in a folder that goes away: what an earlier build has left would be in the next wheel."""

    def initialize_options(self) -> None:
        """Take a folder of its own."""
        super().initialize_options()
        self.build_base = tempfile.mkdtemp(prefix="alula-build-")
        atexit.register(shutil.rmtree, self.build_base, ignore_errors=True)


class BuildForFlight(build_py):
    """Copies messages and kernels to where the runtime looks for them."""

    def run(self) -> None:
        """Build as always, then copy; an editable install has pymavlink, from the workbench, and compiles kernels."""
        super().run()
        if self.editable_mode:
            return
        origin = f"# From pymavlink {metadata.version('pymavlink')}, {DIALECT}.\n"
        target = Path(self.build_lib, "runtime/link/mavlink_messages.py")
        target.write_text(origin + _pymavlink(DIALECT).read_text(encoding="utf-8"), encoding="utf-8")
        if KERNELS:
            shutil.copytree(KERNELS, Path(self.build_lib, "runtime/control/rti/kernels"), dirs_exist_ok=True)


def _pymavlink(path: str) -> Path:
    """A file of pymavlink, which is not imported: that would need what it requires."""
    spec = util.find_spec("pymavlink")
    if spec is None or spec.origin is None:
        raise SystemExit("building Alula needs pymavlink: pip install pymavlink, or build with pip's isolation")
    return Path(spec.origin).parent.parent / path


class WheelOfItsMachine(bdist_wheel):
    """Tags a wheel with kernels by the machine that they are for; they need no newer C library than manylinux2014's."""

    def get_tag(self) -> tuple[str, str, str]:
        """Python, ABI and platform tag."""
        if not KERNELS:
            return super().get_tag()
        (machine,) = (path.name for path in Path(KERNELS).iterdir() if path.is_dir())
        return "py3", "none", f"manylinux_2_17_{machine}.manylinux2014_{machine}"


setup(cmdclass={"build": BuildElsewhere, "build_py": BuildForFlight, "bdist_wheel": WheelOfItsMachine})
