"""Models that need no data of their own: Lambertian, and the file forms under their names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from instrument.errors import InputError
from instrument.forms import Form, parse_form
from twin.material import Material, lambertian, open_netcdf
from twin.reflection_models import Origin


class LambertianSettings(Form):
    """Keys of the model ``lambertian``."""

    reflectance: Annotated[float, Field(ge=0, le=1)]


class TableSettings(Form):
    """Keys of the model ``table``."""

    file: str


def lambertian_model(settings: Mapping[str, Any], origin: Origin) -> Material:
    """A surface of constant BRDF."""
    return lambertian(parse_form(dict(settings), LambertianSettings, origin.where).reflectance)


def table_model(settings: Mapping[str, Any], origin: Origin) -> Material:
    """A ready table."""
    from twin.reflection_models.table import from_table

    path = origin.file(parse_form(dict(settings), TableSettings, origin.where).file)
    dataset = open_netcdf(path)
    if "brdf" not in dataset:
        raise InputError(f"{path}: found no variable 'brdf'; expected a table")
    return from_table(dataset, str(path))
