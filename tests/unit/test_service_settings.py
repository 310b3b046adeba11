"""Settings: strict, from environment and file, faults named with the variable and the remedy."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

import pytest
from pydantic import Field, SecretStr
from pydantic_settings import SettingsConfigDict

from vertebra.errors import ConfigError
from vertebra.service import ServiceSettings, describe, load_settings


class ProbeSettings(ServiceSettings):
    """What these tests need."""

    model_config = SettingsConfigDict(env_prefix="VERTEBRA_PROBE_")

    name_server: str = "127.0.0.1:10000"
    rate_hz: float = Field(30.0, gt=0)
    kind: Literal["a", "b"] = "a"
    keys: tuple[str, ...] = ()
    token: SecretStr = Field(SecretStr(""), max_length=12)


@pytest.fixture(autouse=True)
def clean(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in os.environ:
        if variable.startswith("VERTEBRA_"):
            monkeypatch.delenv(variable)


def refusal() -> str:
    with pytest.raises(ConfigError) as caught:
        load_settings(ProbeSettings)
    return str(caught.value)


def test_defaults_hold_without_any_variable() -> None:
    settings = load_settings(ProbeSettings)
    assert (settings.rate_hz, settings.router, settings.instance) == (
        30.0,
        "tcp/127.0.0.1:7447",
        "1",
    )


def test_variables_of_the_service_and_of_the_fleet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_PROBE_RATE_HZ", "5")
    monkeypatch.setenv("VERTEBRA_PROBE_KEYS", '["a", "b"]')
    monkeypatch.setenv("VERTEBRA_ROUTER", "tcp/router:7447")
    settings = load_settings(ProbeSettings)
    assert (settings.rate_hz, settings.keys, settings.router) == (5, ("a", "b"), "tcp/router:7447")


def test_an_empty_variable_is_an_unset_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_PROBE_RATE_HZ", "")
    monkeypatch.setenv("VERTEBRA_ROUTER", "")
    assert load_settings(ProbeSettings) == ProbeSettings()


def test_an_unknown_variable_is_refused_with_a_suggestion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_PROBE_NAMESERVER", "x")
    assert refusal() == (
        "VERTEBRA_PROBE_NAMESERVER is not a setting; did you mean VERTEBRA_PROBE_NAME_SERVER?"
    )


def test_an_unknown_variable_that_resembles_nothing_lists_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("VERTEBRA_PROBE_QQQQQQQQQQQQQQQQQQQQQQQ", "x")
    assert "known: VERTEBRA_PROBE_FILE, VERTEBRA_PROBE_KEYS, VERTEBRA_PROBE_KIND" in refusal()


def test_all_faults_are_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_PROBE_RATE_HZ", "-1")
    monkeypatch.setenv("VERTEBRA_PROBE_KIND", "c")
    monkeypatch.setenv("VERTEBRA_LOG_LEVEL", "loud")
    rate, kind, level = sorted(refusal().splitlines(), key=lambda line: "PROBE_RATE" not in line)
    assert rate == "VERTEBRA_PROBE_RATE_HZ = '-1': Input should be greater than 0"
    assert "VERTEBRA_PROBE_KIND = 'c'" in f"{kind}\n{level}"
    assert "VERTEBRA_LOG_LEVEL = 'loud'" in f"{kind}\n{level}"


def test_a_list_that_is_no_json_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_PROBE_KEYS", "a,b")
    assert refusal() == 'VERTEBRA_PROBE_KEYS = \'a,b\': lists are JSON, such as ["a", "b"]'


def test_a_fault_inside_a_list_says_where(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_PROBE_KEYS", '["a", 7]')
    assert refusal().startswith("VERTEBRA_PROBE_KEYS.1 = 7: ")


def test_the_environment_wins_over_the_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "probe.yaml"
    file.write_text("rate_hz: 5\nkind: b\nkeys: [a]\n")
    monkeypatch.setenv("VERTEBRA_PROBE_FILE", str(file))
    monkeypatch.setenv("VERTEBRA_PROBE_RATE_HZ", "7")
    settings = load_settings(ProbeSettings)
    assert (settings.rate_hz, settings.kind, settings.keys) == (7, "b", ("a",))


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ("rate: 5", "rate is not a setting; did you mean rate_hz"),
        ("rate_hz: fast", "VERTEBRA_PROBE_RATE_HZ = 'fast'"),
        ("- a", "is a list, not a map"),
        ("a: [", "is no YAML"),
        ("router: tcp/x:1", "router is not a setting"),
    ],
)
def test_faults_of_the_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, content: str, match: str
) -> None:
    file = tmp_path / "probe.yaml"
    file.write_text(content)
    monkeypatch.setenv("VERTEBRA_PROBE_FILE", str(file))
    assert match in refusal()


def test_an_empty_file_sets_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "probe.yaml"
    file.touch()
    monkeypatch.setenv("VERTEBRA_PROBE_FILE", str(file))
    assert load_settings(ProbeSettings) == ProbeSettings()


def test_a_file_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_PROBE_FILE", "/nowhere/probe.yaml")
    assert "'/nowhere/probe.yaml' cannot be read" in refusal()


def test_secrets_are_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VERTEBRA_PROBE_TOKEN", "correct")
    settings = load_settings(ProbeSettings)
    assert settings.token.get_secret_value() == "correct"
    assert "correct" not in describe(settings)
    assert "rate_hz: 30.0\n" in describe(settings)
    monkeypatch.setenv("VERTEBRA_PROBE_TOKEN", "correct horse battery")
    assert refusal().startswith("VERTEBRA_PROBE_TOKEN = (secret): ")
    assert "horse" not in refusal()
