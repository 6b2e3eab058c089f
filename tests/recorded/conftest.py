"""A real vcan0, and figures at the end of the run."""

from tests.vcan.conftest import (  # noqa: F401
    a_real_vcan0,
    figures,
    pytest_terminal_summary,
)
