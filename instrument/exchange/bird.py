"""The universal BRDF data format, version 1.0: what writing and reading it have in common.

The format is that of D. Lanevski et al., Color Res. Appl. 47 (2022) 1177, DOI 10.1002/col.22790, with the JSON schemas
that its authors publish as BiRDview. Required are the five arrays of :data:`REQUIRED`; zeniths lie between 0 and 90
degrees (90 excluded), azimuths between 0 and 360 (360 excluded), the BRDF is in 1/sr and never negative.
"""

from __future__ import annotations

#: Where the schema is published; its name carries the version.
SCHEMA = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json"
VERSION = "1.0"
REQUIRED = ("theta_i", "phi_i", "theta_r", "phi_r", "BRDF")
#: Standard arrays of the format; anything else is the laboratory's own and lies in ``adhoc_variables``.
OPTIONAL = ("uBRDF", "wavelength_i", "wavelength_r", "polarization_i", "polarization_r")
ZENITHS, AZIMUTHS = ("theta_i", "theta_r"), ("phi_i", "phi_r")
DEGREE_UNITS, RADIAN_UNIT = ("deg", "°"), "rad"
BRDF_UNITS = ("1/sr", "sr^-1")
WAVELENGTH_UNITS = {"nm": 1.0, "μm": 1e3, "µm": 1e3, "um": 1e3}

#: Our words for polarised light, by the format's letters and by its Stokes vectors (normalised to intensity).
LETTERS = {"s": "s", "p": "p", "u": "mean"}
STOKES = {(1.0, 1.0, 0.0, 0.0): "s", (1.0, -1.0, 0.0, 0.0): "p", (1.0, 0.0, 0.0, 0.0): "mean"}

#: Key of what the format has no place for, inside ``metadata.adhoc_section``; and the version of that form.
SECTION, SECTION_VERSION = "goniotwin", 1
UNSTATED = "not stated"
