"""Checks JSON documents against a JSON Schema: check_schema.py SCHEMA DOCUMENT..."""

import json
import sys

import jsonschema


def load(path):
    with open(path, encoding="utf-8") as file:
        return json.load(file)


schema, *documents = sys.argv[1:]
rules = load(schema)
jsonschema.Draft202012Validator.check_schema(rules)
validator = jsonschema.Draft202012Validator(rules)
faults = [
    f"{path}: {'/'.join(map(str, error.absolute_path))}: {error.message[:300]}"
    for path in documents
    for error in validator.iter_errors(load(path))
]
print("\n".join(faults) or f"{len(documents)} documents agree with {schema}")
sys.exit(bool(faults))
