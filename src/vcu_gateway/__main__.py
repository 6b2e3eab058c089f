"""`python -m vcu_gateway` is `vcu-gateway`."""

from vcu_gateway.cli import main

main()
