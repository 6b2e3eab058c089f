"""Code generation: its page of documentation shows the source that really comes out."""

import textwrap

import pytest

from vcu_gateway.core import codegen
from vcu_gateway.protocol import dbc, packaged

MESSAGE = dbc.load(packaged("vcu.dbc")).message("VCU_PCU1_Command")


@pytest.mark.parametrize("write", [codegen.decoder, codegen.encoder])
def test_the_documented_source_is_the_one_that_is_generated(write):
    source = write(MESSAGE, codegen.plan(MESSAGE))
    documented = " ".join(textwrap.dedent(codegen.__doc__ or "").split())
    assert " ".join(source.split()) in documented
