from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from instrument.errors import InputError
from twin import llvm


def test_the_chosen_library_is_new_enough() -> None:
    assert (llvm.llvm_version(llvm.choose_llvm({})) or 0) >= llvm.OLDEST_LLVM


def test_a_library_named_by_the_user_is_honoured() -> None:
    chosen = llvm.choose_llvm({})
    assert llvm.choose_llvm({llvm.VARIABLE: str(chosen)}) == chosen


def test_a_missing_library_named_by_the_user_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"DRJIT_LIBLLVM_PATH.*absent\.so.*found no LLVM library"):
        llvm.choose_llvm({llvm.VARIABLE: str(tmp_path / "absent.so")})


def test_a_file_that_is_no_library_is_an_error(tmp_path: Path) -> None:
    fake = tmp_path / "libLLVM.so"
    fake.write_text("not a library")
    with pytest.raises(InputError, match="found no LLVM library; expected LLVM 16 or newer"):
        llvm.choose_llvm({llvm.VARIABLE: str(fake)})


@pytest.mark.parametrize("name", ["libLLVM-14.so.1", "libLLVM-15.so.1", "libLLVM.so.15.0"])
def test_versions_that_abort_the_process_are_refused_before_they_are_loaded(tmp_path: Path, name: str) -> None:
    old = tmp_path / name
    old.write_text("")  # were it loaded, the version would be unknown, not 14 or 15
    assert llvm.llvm_version(old) in (14, 15)
    with pytest.raises(InputError, match="expected LLVM 16 or newer"):
        llvm.choose_llvm({llvm.VARIABLE: str(old)})


def test_the_newest_library_of_the_system_serves_where_the_package_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = llvm.choose_llvm({})
    (tmp_path / "libLLVM-15.so.1").write_text("")
    (tmp_path / "libLLVM-19.so.1").symlink_to(good)
    monkeypatch.setattr(llvm, "_packaged", list)
    monkeypatch.setattr(llvm, "_SYSTEM_PATTERNS", (f"{tmp_path}/libLLVM*",))
    assert os.path.realpath(llvm.choose_llvm({})) == os.path.realpath(good)


def test_without_any_library_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(llvm, "_packaged", list)
    monkeypatch.setattr(llvm, "_SYSTEM_PATTERNS", ())
    with pytest.raises(InputError, match=r"No LLVM library of version 16 or newer.*install.*DRJIT_LIBLLVM_PATH"):
        llvm.choose_llvm({})


def test_a_packaged_library_that_does_not_load_is_named_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "libLLVM.so"
    broken.write_text("not a library")
    monkeypatch.setattr(llvm, "_packaged", lambda: [broken])
    monkeypatch.setattr(llvm, "_SYSTEM_PATTERNS", ())
    with pytest.raises(InputError, match=r"karellen-llvm-core is installed, but .*libLLVM\.so"):
        llvm.choose_llvm({})


@pytest.mark.parametrize(
    ("built", "working", "chosen"),
    [
        (("scalar_rgb", "llvm_ad_mono", "cuda_ad_mono"), {"cuda_ad_mono", "llvm_ad_mono"}, "cuda_ad_mono"),
        (("scalar_rgb", "llvm_ad_mono", "cuda_ad_mono"), {"llvm_ad_mono"}, "llvm_ad_mono"),
        (("scalar_rgb", "llvm_ad_mono"), {"llvm_ad_mono"}, "llvm_ad_mono"),
        (("llvm_ad_mono", "cuda_ad_mono"), {"cuda_ad_mono"}, "cuda_ad_mono"),
        (("scalar_rgb", "llvm_ad_mono"), set(), None),
    ],
)
def test_a_gpu_is_used_where_one_answers(built: tuple[str, ...], working: set[str], chosen: str | None) -> None:
    def answers(variant: str) -> bool:
        assert variant in built  # the backend of a variant that is not there is never touched
        return variant in working

    assert llvm.choose_variant(built, answers) == chosen


def test_a_machine_with_neither_gpu_nor_llvm_says_what_to_install() -> None:
    program = (
        "from twin import llvm; llvm._packaged = list; llvm._SYSTEM_PATTERNS = ()\n"
        "from instrument.errors import InputError\n"
        "import drjit as dr; dr.has_backend = lambda backend: False\n"
        "try: llvm.import_mitsuba()\n"
        "except InputError as error: print(error)"
    )
    environment = {name: value for name, value in os.environ.items() if name != llvm.VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True, env=environment
    )
    assert "No LLVM library of version 16 or newer" in done.stdout


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no CPU affinity on this platform")
def test_threads_honour_cpu_affinity() -> None:
    program = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from twin.llvm import import_mitsuba; mi = import_mitsuba()\n"
        "import drjit as dr; print(mi.variant(), dr.thread_count())"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.split() in (["llvm_ad_mono", "1"], ["cuda_ad_mono", "1"])
