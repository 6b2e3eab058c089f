"""Users of the page: their file, and the hashes of their passwords."""

import pytest
from click.testing import CliRunner

from vcu_gateway.cli import web
from vcu_gateway.errors import ConfigError, MissingInputError
from vcu_gateway.web import users
from vcu_gateway.web.users import PasswordHash, User, UserRole

LINE = User("anna", UserRole.OPERATOR, PasswordHash.of("a long password")).line()


def test_a_line_is_read_back_and_its_password_matches_and_no_other_does():
    anna = users.parse([LINE], "users")["anna"]
    assert anna.role is UserRole.OPERATOR
    assert anna.password.matches("a long password")
    for wrong in ("a long passwort", "", "A long password", "a long password ", "\ud800"):
        assert not anna.password.matches(wrong)


def test_equal_passwords_have_different_hashes():
    assert PasswordHash.of("the same one").text() != PasswordHash.of("the same one").text()


def test_comments_and_empty_lines_are_nothing():
    assert list(users.parse(["# people", "", LINE], "users")) == ["anna"]


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([], "has no user"),
        (["anna operator"], "users:1: is not NAME ROLE HASH"),
        ([LINE.replace("operator", "services")], 'did you mean "service"?'),
        ([LINE.replace("anna", "an/na")], "other characters"),
        ([LINE, LINE], "users:2: there is a user anna already"),
        ([LINE.replace("scrypt:", "md5:")], "none of scrypt's"),
        ([LINE.replace(":16384:", ":2:")], "none of scrypt's"),
        ([LINE.replace(":16384:", ":16385:")], "none of scrypt's"),
        ([LINE[:-8]], "none of scrypt's"),
        (["anna viewer scrypt:16384:8:5:!:!"], "none of scrypt's"),
    ],
)
def test_a_wrong_line_is_named_with_what_is_wrong(lines, said):
    with pytest.raises(ConfigError) as refused:
        users.parse(lines, "users")
    assert said in str(refused.value)


def test_every_wrong_line_is_named_at_once():
    with pytest.raises(ConfigError) as refused:
        users.parse(["x", LINE, "y"], "users")
    assert len(refused.value.problems) == 2


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(MissingInputError, match="cannot read the users"):
        users.read(tmp_path / "nobody")


def test_the_verb_prints_a_line_that_is_read_back():
    given = "a long password\na long password\n"
    done = CliRunner().invoke(web.web_user, ["anna", "--role", "service"], input=given)
    line = done.stdout.splitlines()[-1]
    assert users.parse([line], "users")["anna"].password.matches("a long password")


@pytest.mark.parametrize(("name", "password"), [("anna", "short"), ("an na", "a long password")])
def test_the_verb_refuses_a_short_password_and_a_name_that_is_none(name, password):
    given = f"{password}\n{password}\n"
    assert CliRunner().invoke(web.web_user, [name], input=given).exit_code == 2
