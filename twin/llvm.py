"""Choose an LLVM library for Dr.Jit before Mitsuba is imported.

Dr.Jit compiles its kernels with whatever ``libLLVM`` it finds first. Some versions abort the whole process in
the middle of a launch (Debian 12 installs LLVM 14 and 15, which do), so the library is chosen here, checked and
handed over in the environment variable ``DRJIT_LIBLLVM_PATH``. Import Mitsuba through :func:`import_mitsuba` only.
"""

from __future__ import annotations

import ctypes
import glob
import os
import platform
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from instrument.errors import InputError

#: Oldest LLVM that compiles every instruction Dr.Jit emits.
OLDEST_LLVM = 16
VARIABLE = "DRJIT_LIBLLVM_PATH"
#: Variants of Mitsuba that serve, best first.
VARIANTS = ("cuda_ad_mono", "llvm_ad_mono")
_PACKAGE = "karellen-llvm-core"
_SYSTEM_PATTERNS = (
    "/usr/lib/*-linux-gnu/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM.dylib",
    "C:/Program Files/LLVM/bin/LLVM-C.dll",
)


def choose_llvm(environment: Mapping[str, str] | None = None) -> Path:
    """Find an LLVM library that Dr.Jit can use.

    The order is the one named in ``DRJIT_LIBLLVM_PATH``, the one of the package ``karellen-llvm-core``, the newest
    of the system.

    Raises
    ------
    InputError
        If ``DRJIT_LIBLLVM_PATH`` names a missing, broken or too old library, or if none is found; the message says
        what to install.
    """
    environment = os.environ if environment is None else environment
    named = environment.get(VARIABLE)
    if named:
        version = llvm_version(Path(named))
        if version is None or version < OLDEST_LLVM:
            found = "no LLVM library" if version is None else f"LLVM {version} or older"
            raise InputError(f"{VARIABLE}: {named}: found {found}; expected LLVM {OLDEST_LLVM} or newer")
        return Path(named)
    for candidate in _candidates():
        version = llvm_version(candidate)
        if version is not None and version >= OLDEST_LLVM:
            return candidate
    raise InputError(_advice())


def llvm_version(library: Path) -> int | None:
    """Major version of an LLVM library; None if the file is none.

    Libraries before 16 have no C function that tells their version; they are reported as 15.
    """
    if not library.exists():
        return None
    by_name = re.search(r"LLVM[-.](?:so\.)?(\d+)", os.path.realpath(library))
    if by_name and int(by_name.group(1)) < OLDEST_LLVM:
        return int(by_name.group(1))
    try:
        handle = ctypes.CDLL(str(library))
    except OSError:
        return None
    if not hasattr(handle, "LLVMContextCreate"):
        return None
    if not hasattr(handle, "LLVMGetVersion"):
        return OLDEST_LLVM - 1
    major, minor, patch = ctypes.c_uint(), ctypes.c_uint(), ctypes.c_uint()
    handle.LLVMGetVersion(ctypes.byref(major), ctypes.byref(minor), ctypes.byref(patch))
    return major.value


@lru_cache(maxsize=1)
def import_mitsuba() -> Any:
    """Import Mitsuba with a working LLVM, its variant set, and as many threads as this process may use.

    Raises
    ------
    InputError
        If neither a GPU answers nor a usable LLVM library is found, or ``DRJIT_LIBLLVM_PATH`` names no usable one.
    """
    library, missing = None, ""
    try:
        library = choose_llvm()
        os.environ[VARIABLE] = str(library)
    except InputError as error:
        if os.environ.get(VARIABLE):
            raise
        missing = str(error)
    import drjit as dr
    import mitsuba as mi

    def answers(variant: str) -> bool:
        backend = {"cuda_ad_mono": dr.JitBackend.CUDA, "llvm_ad_mono": dr.JitBackend.LLVM}[variant]
        # Dr.Jit left to itself would take any LLVM library, also one that aborts the process.
        return (library is not None or backend != dr.JitBackend.LLVM) and bool(dr.has_backend(backend))

    variant = choose_variant(mi.variants(), answers)
    if variant is None:
        raise InputError(missing or f"{library}: Dr.Jit could not load this LLVM library. {_advice()}")
    mi.set_variant(variant)
    dr.set_thread_count(usable_cores())
    return mi


def choose_variant(variants: Sequence[str], answers: Callable[[str], bool]) -> str | None:
    """The variant of Mitsuba to use: on the GPU where one answers, else on the processor; None where neither does.

    Parameters
    ----------
    variants
        What this Mitsuba was built with.
    answers
        Whether the device of a variant is there and works; not asked for variants that are not built.
    """
    return next((name for name in VARIANTS if name in variants and answers(name)), None)


def usable_cores() -> int:
    """Number of processor cores this process may run on; honours CPU affinity."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _candidates() -> Iterator[Path]:
    """Libraries to try, best first."""
    yield from _packaged()
    found = {os.path.realpath(path) for pattern in _SYSTEM_PATTERNS for path in glob.glob(pattern)}
    yield from (Path(path) for path in sorted(found, key=_version_in_name, reverse=True))


def _packaged() -> list[Path]:
    try:
        files = metadata.files(_PACKAGE) or []
    except metadata.PackageNotFoundError:
        return []
    names = {"linux": "libLLVM.so", "darwin": "libLLVM.dylib", "win32": "LLVM-C.dll"}
    wanted = names.get(sys.platform, "libLLVM.so")
    return [Path(str(file.locate())).resolve() for file in files if file.name == wanted]


def _version_in_name(path: str) -> tuple[int, ...]:
    numbers = re.findall(r"\d+", Path(path).name)
    return tuple(int(number) for number in numbers)


def _advice() -> str:
    system, machine = platform.system(), platform.machine()
    if system == "Linux" and machine == "x86_64":
        install = f"pip install {_PACKAGE}, or on Debian and Ubuntu: apt-get install libllvm19 (any of 16 to 23)"
    elif system == "Linux":
        install = "on Debian and Ubuntu: apt-get install libllvm19; on Fedora: dnf install llvm-libs"
    elif system == "Darwin":
        install = "brew install llvm"
    else:
        install = "install LLVM from https://releases.llvm.org"
    return (
        f"No LLVM library of version {OLDEST_LLVM} or newer was found on this {system} {machine} machine, and the ray"
        f" tracer needs one: {install}. Or name one in the environment variable {VARIABLE}.{_unloadable()}"
    )


def _unloadable() -> str:
    """Why the packaged library, where it is installed, does not load: often a system library that it needs."""
    for library in _packaged():
        try:
            ctypes.CDLL(str(library))
        except OSError as error:
            return (
                f" The package {_PACKAGE} is installed, but its library does not load: {error}"
                " (libatomic.so.1 comes with Debian's libatomic1)."
            )
    return ""
