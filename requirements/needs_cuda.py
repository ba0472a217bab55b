"""Exit 0 where the installed torch needs NVIDIA's libraries, 1 where it is a build for the processor alone."""

import sys
from importlib import metadata

sys.exit(not any(requirement.startswith("nvidia-") for requirement in metadata.requires("torch") or []))
