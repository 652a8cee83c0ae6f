"""What is said before a scan of certificate, warm-up and calibrations that are due."""

from __future__ import annotations

from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import pytest
from scan_stage import FACILITY, QUICK, stage

from instrument.errors import InputError
from instrument.events import Message
from instrument.facility import Calibration
from instrument.forms import parse_form
from instrument.procedures.results import CalibrationResult, Quantity, latest, read_result, read_results, store
from instrument.procedures.standing import calibration_lines, certificate_line, warm_up_line, with_facility
from instrument.reference_standard import CertifiedFactor, ReferenceStandard
from instrument.settings import ScanSettings

NOW = datetime(2026, 11, 22, 12, 0, tzinfo=UTC)


def result(procedure: str, days: float, verdict: str = "passed", stable_after: float = 0.0) -> CalibrationResult:
    return CalibrationResult(
        procedure=procedure,
        taken=NOW - timedelta(days=days),
        verdict=verdict,
        summary="as a test says",
        values={"warm-up time": Quantity(value=stable_after, unit="s")},
    )


def facility(folder: Path, **wanted: object):
    return FACILITY.model_copy(update={"calibration": Calibration(results=str(folder), **wanted)})


def test_a_result_reads_back_as_it_was_stored_and_is_never_replaced(tmp_path: Path):
    first = result("linearity", 1.0)
    paths = [store(first, tmp_path / "new"), store(first, tmp_path / "new")]
    assert paths[0] != paths[1]
    assert read_result(paths[0]) == read_result(paths[1]) == first
    assert paths[0].name == "20261121T120000Z-linearity.json"


def test_results_come_oldest_first_and_the_youngest_counts(tmp_path: Path):
    for days in (3.0, 9.0, 1.0):
        store(result("linearity", days), tmp_path)
    store(result("wavelength", 0.1), tmp_path)
    assert [r.age(NOW).days for r in read_results(tmp_path, "linearity")] == [9, 3, 1]
    found = latest(tmp_path, "linearity")
    assert found is not None
    assert found.age(NOW) == timedelta(days=1)
    assert latest(tmp_path / "nowhere", "linearity") is None


@pytest.mark.parametrize("text", ["{", "[]", '{"format": "something else"}', '{"format": "goniotwin-calibration"}'])
def test_a_damaged_result_is_named(tmp_path: Path, text: str):
    (tmp_path / "broken.json").write_text(text)
    with pytest.raises(InputError, match=r"broken\.json"):
        read_results(tmp_path)


def test_what_is_due_and_what_is_not(tmp_path: Path):
    store(result("linearity", 10.0), tmp_path)
    store(result("wavelength", 10.0), tmp_path)
    store(result("gain-ratio", 1.0, "failed"), tmp_path)
    due = {"linearity": 30.0, "wavelength": 7.0, "gain-ratio": 30.0, "dark-level": 1.0}
    lines = {name: (good, found) for name, good, found in calibration_lines(facility(tmp_path, due_days=due), NOW)}
    assert {name: good for name, (good, _) in lines.items()} == {
        "linearity": True,
        "wavelength": False,
        "gain-ratio": False,
        "dark-level": False,
    }
    assert "10.0 days ago, due every 7" in lines["wavelength"][1]
    assert "never done" in lines["dark-level"][1]


def test_a_procedure_that_does_not_exist_is_refused():
    with pytest.raises(InputError, match="no procedure 'lineararity'"):
        parse_form({"due_days": {"lineararity": 3.0}}, Calibration, "facility.toml")


def test_the_warm_up_is_held_against_the_last_one_that_was_measured(tmp_path: Path):
    known = facility(tmp_path)
    assert warm_up_line(known, 0.0, False)[1]
    store(result("warm-up", 2.0, stable_after=1800.0), tmp_path)
    assert not warm_up_line(known, 600.0, False)[1]
    assert warm_up_line(known, 1800.0, False)[1]
    assert warm_up_line(known, 0.0, True)[1]
    store(result("warm-up", 1.0, "failed"), tmp_path)
    assert not warm_up_line(known, 1800.0, False)[1]


def test_the_facility_sets_the_warm_up_of_a_scan():
    settings = with_facility(ScanSettings(warm_up=30.0), facility(Path("x"), warm_up_minutes=20.0))
    assert (settings.warm_up, settings.emission_while_mounting) == (1200.0, False)
    assert with_facility(ScanSettings(warm_up=30.0), FACILITY).warm_up == 30.0


def test_the_certificate_s_last_days_are_counted():
    standard = ReferenceStandard(
        identity="tile",
        valid_from=date(2026, 1, 1),
        valid_until=date(2026, 12, 2),
        reflectance_factor=(CertifiedFactor(wavelength=500.0, sensor_zenith=15.0, value=0.99, u=0.005),),
    )
    known = FACILITY.model_copy(update={"reference": FACILITY.reference.model_copy(update={"certificate": standard})})
    assert certificate_line(known, NOW) == ("certificate", True, "tile, valid until 2026-12-02 (10 days left)")
    line = certificate_line(known, NOW + timedelta(days=11))
    assert line is not None
    assert not line[1]
    assert certificate_line(FACILITY, NOW) is None


@pytest.mark.parametrize(("overdue", "outcome"), [("warn", "finished"), ("refuse", "faulted")])
def test_a_scan_says_what_is_overdue_and_refuses_where_the_facility_does(tmp_path: Path, overdue: str, outcome: str):
    known = facility(tmp_path / "results", due_days={"linearity": 30.0}, overdue=overdue)
    (tmp_path / "run").mkdir()
    scan = stage(tmp_path / "run", facility=known, settings=QUICK)
    end = scan.run()
    assert end.outcome == outcome
    if overdue == "warn":
        assert any("never done" in event.text for event in scan.events(Message))
    else:
        assert "never done" in end.reason
        assert not any(axis.busy() for axis in scan.bench.axes.values())
        assert scan.bench.log == []
