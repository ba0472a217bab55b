"""Compiled controllers: compiler, cache folder, and instruction set."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time

from dynamics import symbolic
from dynamics.codegen import FLAGS, build_library, cache_folder, find_compiler, has_compiler, require_own_folder
from dynamics.errors import RequestError
from dynamics.trust import load_own_library
from runtime.control.bundle import Bundle
from runtime.control.rti.prebuilt import FOLDER
from runtime.control.rti.processor import PROCESSORS, native_processor
from runtime.machine.check import Check

COMPILER, CACHE, SIMD = "compiler", "cache folder", "SIMD"
NOT_NEEDED = "not needed: the bundle brings its compiled controller"
TRIAL = "int alula_trial(int x) { return x + 1; }\n"


def check_cache() -> Check:
    """Whether the folder of compiled code is this user's, can be written, and may hold code that runs."""
    folder = cache_folder()
    advice = "set ALULA_CACHE to a folder of yours on a disk that may hold programs"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        require_own_folder(folder)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"trial")
        place = os.statvfs(folder)
    except OSError as error:
        return Check(CACHE, "problem", f"{folder} cannot be written: {error.strerror or error}", advice)
    except RequestError as error:
        return Check(CACHE, "problem", str(error), advice)
    if place.f_flag & os.ST_NOEXEC:
        return Check(CACHE, "problem", f"{folder} is on a file system of which nothing runs (noexec)", advice)
    free = place.f_bavail * place.f_frsize
    return Check(CACHE, "ok", f"{folder} can be written, {free / 1e9:.1f} GB free")


def check_compiler(*, cache_usable: bool) -> Check:
    """Whether a C compiler makes code with the flags of our kernels that this computer loads and runs."""
    advice = "install one, such as Debian's gcc"
    if not has_compiler():
        measured = "none (looked for $CC, cc, gcc, clang): a bundle flies, and vehicles whose controllers are prebuilt"
        return Check(COMPILER, "warning", measured, f"{advice}, or fly a bundle of `alula export`")
    compiler = find_compiler()
    done = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False)
    name = f"{compiler}: {done.stdout.partition(chr(10))[0] or 'unknown version'}"
    if not cache_usable:
        return Check(COMPILER, "warning", f"{name}, not tried without a cache folder", "see the cache folder")
    began = time.monotonic()
    try:
        library = build_library({"trial.c": f"{TRIAL}// {time.time_ns()}\n"}, entry="trial.c")
        right = load_own_library(library).alula_trial(41) == 42
    except (RequestError, OSError) as error:
        return Check(COMPILER, "problem", f"{name}: {error}", advice)
    taken = time.monotonic() - began
    library.unlink(missing_ok=True)
    library.with_name(f"{library.name}.lock").unlink(missing_ok=True)
    if not right:
        return Check(COMPILER, "problem", f"{name} makes code that gives wrong answers", advice)
    return Check(COMPILER, "ok", f"{name}; a trial with {' '.join(FLAGS[:2])} compiled and ran in {taken:.2f} s")


def check_simd(bundle: Bundle | None) -> Check:
    """The instruction set of the kernel that flies."""
    try:
        processor = native_processor()
    except RequestError as error:
        return Check(SIMD, "problem", str(error), "fly from an x86-64 or an aarch64 computer")
    if bundle is not None:
        built = PROCESSORS[bundle.manifest.processor]
        flags, source = built.compiler_flags, f"the bundle's kernel for {built.name}"
    elif has_compiler() and symbolic.is_installed():
        built, flags, source = processor, FLAGS, f"kernels are compiled here, for {processor.name}"
    else:
        names = sorted({path.name.partition("-")[0] for path in FOLDER.glob(f"{processor.machine}/*.so")})
        usable = [each for each in PROCESSORS.values() if each.runs_here and each.name in names]
        if not usable:
            measured = "no prebuilt controller came with this install, and none can be compiled here"
            return Check(SIMD, "problem", measured, "fly a bundle of `alula export`, or install CasADi and a compiler")
        built = usable[0]
        flags, source = built.compiler_flags, f"prebuilt kernels for {built.name}"
    options = " ".join(flag for flag in flags if flag.startswith(("-O", "-m")))
    measured = f"{source} ({options}), vectors of {built.vector} bytes"
    if built.vector < processor.vector and bundle is not None:
        return Check(SIMD, "warning", measured, f"export again with --processor {processor.name}, which this one has")
    return Check(SIMD, "ok", measured)
