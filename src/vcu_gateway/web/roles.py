"""Roles of the page's users, and the right of the gateway that each action needs."""

from collections.abc import Mapping
from enum import Enum

from vcu_gateway.api.errors import Right


class UserRole(Enum):
    """Role of a user; each has all that the ones before it have."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    SERVICE = "service"

    @property
    def rights(self) -> frozenset[Right]:
        """Rights of the gateway that a user of this role may use through the page."""
        return _RIGHTS[self]


_RIGHTS: Mapping[UserRole, frozenset[Right]] = {
    UserRole.VIEWER: frozenset({Right.READ}),
    UserRole.OPERATOR: frozenset({Right.READ, Right.OPERATE}),
    UserRole.SERVICE: frozenset(Right),
}

ACTION_RIGHTS: Mapping[str, Right] = {
    "estop": Right.READ,
    "disarm": Right.READ,
    "arm": Right.OPERATE,
    "reset driver": Right.OPERATE,
    "reset service": Right.SERVICE,
}
"""As the gateway has it: whoever may look may stop. A demand is not among them."""
