"""Whether the reference standard may be used for a scan, before anything starts."""

from __future__ import annotations

from datetime import date

from instrument.errors import InputError
from instrument.reference_standard import ACCEPTED, objections
from instrument.request import ScanInputs


def checked_reference(inputs: ScanInputs, accept: bool, today: date) -> list[str]:
    """Hold the certificate of the reference against a plan and the day.

    Parameters
    ----------
    accept
        Whether the operator says that it is to be used all the same.
    today
        UTC.

    Returns
    -------
    list of str
        What was accepted; empty where nothing is amiss or there is no certificate.

    Raises
    ------
    InputError
        If something is amiss and nobody accepted it, now or when the run began.
    """
    known = inputs.facility.reference
    if known.standard is None:
        return []
    found = objections(
        known.standard,
        today,
        [point.wavelength for point in inputs.plan.points],
        known.illumination_zenith,
        known.sensor_zenith,
    )
    accepted_before = inputs.resumed.header.get(ACCEPTED, []) if inputs.resumed else []
    new = [objection for objection in found if objection not in accepted_before]
    if new and not accept and not (accepted_before and all("expired" in objection for objection in new)):
        listed = "; ".join(new)
        raise InputError(
            f"{inputs.facility_path}: reference.certificate: {known.standard.identity}: {listed};"
            " --accept-reference goes on with it, and the run says so"
        )
    return found
