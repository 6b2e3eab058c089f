"""Exceptions of the client."""

from vcu_gateway.api.errors import ErrorCode


class ClientError(Exception):
    """Base class of the client's exceptions."""


class UnreachableError(ClientError):
    """No connection could be opened; the message says what to do."""


class DisconnectedError(ClientError):
    """The connection broke before the answer came.

    Attributes:
        carried_out: False where the gateway cannot have got the whole request; None where
            this is unknown: `why()` and `state()` tell on a new connection.
    """

    def __init__(self, sentence: str, *, carried_out: bool | None = None) -> None:
        super().__init__(sentence)
        self.carried_out = carried_out


class GarbledError(DisconnectedError):
    """The peer sent what is not JSON-RPC of a gateway; the connection was closed."""


class ApiTimeoutError(ClientError):
    """No answer in time; a request that changes something may still be carried out."""


class ApiError(ClientError):
    """The gateway answered with an error.

    Attributes:
        code: JSON-RPC error code.
        word: the code's stable name, such as `invalid_params`.
        sentence: the reason, for people.
        refusal: identifier of a refusal, such as `other_owner`; empty for other errors.
        problems: a sentence for each thing wrong with a configuration.
    """

    def __init__(
        self,
        code: int,
        word: str,
        sentence: str,
        refusal: str = "",
        problems: tuple[str, ...] = (),
    ) -> None:
        super().__init__(sentence)
        self.code = code
        self.word = word
        self.sentence = sentence
        self.refusal = refusal
        self.problems = problems


class RefusedError(ApiError):
    """The gateway refused the request in its present state."""


class NoRightError(ApiError):
    """This process lacks the right to the request."""


class ConfigRefusedError(ApiError):
    """The new configuration was not taken; the old one is in effect."""


_CLASSES: dict[int, type[ApiError]] = {
    ErrorCode.REFUSED.value: RefusedError,
    ErrorCode.NO_RIGHT.value: NoRightError,
    ErrorCode.CONFIG_REFUSED.value: ConfigRefusedError,
}


def api_error(error: object) -> ApiError:
    """Exception for the `error` member of a response; ValueError where it is malformed."""
    if not isinstance(error, dict) or type(error.get("code")) is not int:
        raise ValueError("the error has no code")
    code, sentence, data = error["code"], str(error.get("message", "")), error.get("data")
    data = data if isinstance(data, dict) else {}
    problems = data.get("problems")
    return _CLASSES.get(code, ApiError)(
        code,
        str(data.get("word") or _word_of(code)),
        sentence,
        str(data.get("refusal", "")),
        tuple(map(str, problems)) if isinstance(problems, list) else (),
    )


def _word_of(code: int) -> str:
    """The stable name of an error code; a later gateway may have more codes."""
    return next((one.name.lower() for one in ErrorCode if one.value == code), "unknown")
