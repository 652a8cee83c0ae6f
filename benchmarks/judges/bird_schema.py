"""The published JSON schemas of the universal BRDF data format on files that we wrote.

Not part of ``make judges``: the schemas are in no package. With a copy of the repository BiRD-project/BiRD_view:
``.bench/judges/bin/python benchmarks/judges/bird_schema.py BiRD_view/BRDF_JSON_schema FILE.json ...``
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from jsonschema import Draft202012Validator, FormatChecker
from referencing import Registry, Resource

TOP = "brdf_json_schema_v1.0.json"


def main() -> int:
    """Print every complaint; 1 where there was any."""
    folder, files = Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]]
    schemas = {}
    for path in sorted(folder.glob("*.json")):
        try:
            schemas[path.name] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            print(f"{path.name}: no JSON itself ({error}); left out")
    base = schemas[TOP]["$id"].removesuffix(TOP)
    # Their references name the files; what the files call themselves differs in places.
    registry = Registry().with_resources([(base + name, Resource.from_contents(s)) for name, s in schemas.items()])
    validator = Draft202012Validator(schemas[TOP], registry=registry, format_checker=FormatChecker())
    wrong = 0
    for file in files:
        errors = list(validator.iter_errors(json.loads(file.read_text(encoding="utf-8"))))
        print(f"{file}: {'valid' if not errors else f'{len(errors)} complaints'}")
        for error in errors:
            print(f"  {'.'.join(map(str, error.absolute_path))}: {error.message[:200]}")
        wrong += len(errors)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
