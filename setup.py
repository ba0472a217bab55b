"""Packaging beyond pyproject.toml: $ALULA_KERNELS names a folder of `export.prebuilt` that the wheel shall carry.

With kernels the wheel is for their machine alone, else for any.
"""

import os
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

KERNELS = os.environ.get("ALULA_KERNELS", "")


class BuildWithKernels(build_py):
    """Copies the kernels to where the runtime looks for them."""

    def run(self) -> None:
        """Build as always, then copy."""
        super().run()
        if KERNELS and not self.editable_mode:
            shutil.copytree(KERNELS, Path(self.build_lib, "runtime/control/rti/kernels"), dirs_exist_ok=True)


class WheelOfItsMachine(bdist_wheel):
    """Tags a wheel with kernels by the machine that they are for; they need no newer C library than manylinux2014's."""

    def get_tag(self) -> tuple[str, str, str]:
        """Python, ABI and platform tag."""
        if not KERNELS:
            return super().get_tag()
        (machine,) = (path.name for path in Path(KERNELS).iterdir() if path.is_dir())
        return "py3", "none", f"manylinux_2_17_{machine}.manylinux2014_{machine}"


setup(cmdclass={"build_py": BuildWithKernels, "bdist_wheel": WheelOfItsMachine})
