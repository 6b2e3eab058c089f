"""What can go wrong between this program and the gateway, each as an exception."""

from vcu_gateway.api.errors import ErrorCode


class ClientError(Exception):
    """The root of everything that the client raises on purpose."""


class UnreachableError(ClientError):
    """No connection came about; the sentence says what to do."""


class DisconnectedError(ClientError):
    """The connection broke before the answer came.

    Attributes:
        carried_out: False where the gateway cannot have got the whole request; None where
            nobody on this side knows. `why()` and `state()` tell after a new connection.
    """

    def __init__(self, sentence: str, *, carried_out: bool | None = None) -> None:
        super().__init__(sentence)
        self.carried_out = carried_out


class GarbledError(DisconnectedError):
    """The other end sent what no gateway sends; the connection was given up."""


class ApiTimeoutError(ClientError):
    """No answer in time; a request that changes something may still be carried out."""


class ApiError(ClientError):
    """The gateway answered with an error.

    Attributes:
        code: JSON-RPC's number; word: its stable name, such as `invalid_params`.
        sentence: why, for a person.
        refusal: machine word of a refusal, such as `other_owner`; empty for other errors.
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
    """Not now, or not this."""


class NoRightError(ApiError):
    """This process may not ask for that."""


class ConfigRefusedError(ApiError):
    """The new configuration was not taken; the old one is in effect."""


_KINDS: dict[int, type[ApiError]] = {
    ErrorCode.REFUSED.value: RefusedError,
    ErrorCode.NO_RIGHT.value: NoRightError,
    ErrorCode.CONFIG_REFUSED.value: ConfigRefusedError,
}


def api_error(error: object) -> ApiError:
    """The `error` member of an answer as an exception; ValueError where it is none."""
    if not isinstance(error, dict) or type(error.get("code")) is not int:
        raise ValueError("the error has no code")
    code, sentence, data = error["code"], str(error.get("message", "")), error.get("data")
    data = data if isinstance(data, dict) else {}
    problems = data.get("problems")
    return _KINDS.get(code, ApiError)(
        code,
        str(data.get("word") or _word_of(code)),
        sentence,
        str(data.get("refusal", "")),
        tuple(map(str, problems)) if isinstance(problems, list) else (),
    )


def _word_of(code: int) -> str:
    """The word of a code that the contract names; a later gateway may have more."""
    return next((one.name.lower() for one in ErrorCode if one.value == code), "unknown")
