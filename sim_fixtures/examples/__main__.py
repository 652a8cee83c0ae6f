"""Make the generated example files anew: ``python -m sim_fixtures.examples``."""

from sim_fixtures.examples.files import COMMITTED_SEED, HOME, example_files, write_material
from sim_fixtures.examples.holes import write_holes

write_holes(HOME / "artifact_holes.csv")
write_material(example_files(), COMMITTED_SEED)
