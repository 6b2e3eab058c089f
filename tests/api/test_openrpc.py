"""The description of the API, for machines and for people, is what the program does."""

import json
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
from scripts.documents import api_page

from vcu_gateway.api import errors, openrpc
from vcu_gateway.api.methods import LEVEL_RIGHTS, METHODS, ResetParams
from vcu_gateway.core.demand import Refusal

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def document():
    return openrpc.document()


def test_every_method_is_described_with_its_parameters_and_right(document):
    described = {method["name"]: method for method in document["methods"]}
    assert list(described) == list(METHODS)
    for name, method in METHODS.items():
        assert described[name]["summary"]
        params = [param["name"] for param in described[name]["params"]]
        assert params == list(method.params.model_fields)
        assert described[name]["x-right"] == method.right.value


def test_every_reference_leads_to_a_schema(document):
    schemas = document["components"]["schemas"]

    def references(part):
        if isinstance(part, dict):
            for key, value in part.items():
                yield from [value] if key == "$ref" else references(value)
        elif isinstance(part, list):
            for one in part:
                yield from references(one)

    found = set(references(document))
    assert len(found) > 20
    assert {reference.rpartition("/")[2] for reference in found} <= schemas.keys()


def test_every_shape_is_documented(document):
    for name, schema in document["components"]["schemas"].items():
        assert schema.get("description"), name
        assert schema["additionalProperties"] is False, name


def test_the_document_is_printed_as_json():
    command = [sys.executable, "-m", "vcu_gateway", "schema", "--api"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert json.loads(done.stdout)["openrpc"].startswith("1.3")


def test_the_page_is_current(document):
    text = (ROOT / "docs" / "api.md").read_text()
    assert api_page.within(text, document) == text, "run `python -m scripts.documents`"


def test_a_request_with_a_level_needs_the_right_of_its_level():
    with_level = [one for one in METHODS.values() if issubclass(one.params, ResetParams)]
    assert {one.right for one in with_level} == {LEVEL_RIGHTS["driver"]}
    assert get_args(ResetParams.model_fields["level"].annotation) == tuple(LEVEL_RIGHTS)
    assert LEVEL_RIGHTS == {"driver": errors.Right.OPERATE, "service": errors.Right.SERVICE}


PEER = errors.Peer(pid=1, uid=1000, groups=frozenset({1000, 44}))
POLICY = errors.Policy(own_uid=500)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "read"),
        ({"operator_uids": frozenset({1000})}, "operate read"),
        ({"operator_gids": frozenset({44})}, "operate read"),
        ({"operator_gids": frozenset({45})}, "read"),
        ({"service_uids": frozenset({1000})}, "read service"),
        ({"service_gids": frozenset({44})}, "read service"),
        ({"own_uid": 1000}, "operate read service"),
    ],
)
def test_rights_come_from_the_user_and_all_groups_of_the_peer(changes, expected):
    found = POLICY._replace(**changes).rights_of(PEER)
    assert " ".join(sorted(right.value for right in found)) == expected


def test_root_may_do_everything():
    assert POLICY.rights_of(PEER._replace(uid=0)) == frozenset(errors.Right)


def test_the_page_names_every_word_of_a_refusal():
    text = (ROOT / "docs" / "api.md").read_text()
    assert [one.value for one in Refusal if f"`{one.value}`" not in text] == []
