"""Cases: runs of the simulated laboratory with something wrong, and the truth about them, sealed."""

from sim_fixtures.cases.effects import known_effects
from sim_fixtures.cases.families import FAMILIES
from sim_fixtures.cases.maker import CaseMaker, Truth, make_case
from sim_fixtures.cases.readings import Laboratory

__all__ = ["FAMILIES", "CaseMaker", "Laboratory", "Truth", "known_effects", "make_case"]
