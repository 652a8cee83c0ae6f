"""What the imperfect instrument would read: an optical model of the sample that shares nothing with the twin."""

from sim_fixtures.reality.coating import EXAMPLE_COATING, Coating
from sim_fixtures.reality.imperfections import Imperfections
from sim_fixtures.reality.reality import Mounted, Reality

__all__ = ["EXAMPLE_COATING", "Coating", "Imperfections", "Mounted", "Reality"]
