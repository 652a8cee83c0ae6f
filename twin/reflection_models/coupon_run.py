"""The model ``coupon``: the table of a coupon run, by a method of one's choice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from instrument.dataset import read_run
from instrument.forms import Form, parse_form
from twin.coupon import Method, from_coupon
from twin.material import Material
from twin.reflection_models import Origin


class CouponSettings(Form):
    """Keys of the model ``coupon``."""

    file: str
    method: Method = "auto"


def coupon_model(settings: Mapping[str, Any], origin: Origin) -> Material:
    """Table of a run over the witness coupon."""
    form = parse_form(dict(settings), CouponSettings, origin.where)
    path = origin.file(form.file)
    return from_coupon(read_run(path), str(path), form.method)
