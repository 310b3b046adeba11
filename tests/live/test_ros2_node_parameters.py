"""Parameters both ways: of ROS nodes on the backbone, and of our node on ROS."""

from __future__ import annotations

from pathlib import Path

import pytest

from vertebra.errors import RemoteError

from .ros2_lab import lab_with, peer

pytestmark = pytest.mark.live

CAMERA = "parameters: [{ros: /lab/camera, key: lab/camera/settings}]"


@pytest.mark.parametrize("key", ["lab/camera/settings", "ros2/lab/camera/parameters"])
async def test_parameters_of_a_node_are_plain_values(tmp_path: Path, key: str) -> None:
    async with lab_with(tmp_path, CAMERA) as lab, peer(lab, "have_parameters") as node:
        await node.until("ready")
        assert await lab.call(f"{key}/list", {}) == {"names": ["many", "rate"]}
        assert await lab.call(f"{key}/get", {}) == {"many": [1.5], "rate": 30.0}
        assert await lab.call(f"{key}/set", {"rate": 10, "many": []}) == {"rate": 10, "many": []}
        assert await lab.call(f"{key}/get", {"names": ["rate"]}) == {"rate": 10.0}
        assert await lab.call(f"{key}/get", {"names": ["many"]}) == {"many": []}


@pytest.mark.parametrize(
    ("word", "document", "told"),
    [
        ("get", {"names": ["rat"]}, "/lab/camera has not all of the parameters rat"),
        ("get", {"name": "rate"}, "unknown field `name`"),
        ("set", {"rate": 200, "many": [2]}, "sets none of rate, many: rate is below 100"),
        ("set", {"rate": "fast"}, "'fast' is string, the parameter is double"),
        ("set", {"rate": {}}, "{} is no value of a parameter"),
        ("change", {}, "parameters are asked for by list, get, set, describe, not by 'change'"),
    ],
)
async def test_mistake_is_told(tmp_path: Path, word: str, document: object, told: str) -> None:
    async with lab_with(tmp_path, CAMERA) as lab, peer(lab, "have_parameters") as node:
        await node.until("ready")
        with pytest.raises(RemoteError, match=told) as caught:
            await lab.call(f"lab/camera/settings/{word}", document)
        assert caught.value.kind == "CommandRefusedError"
        assert (await lab.call("lab/camera/settings/get", {}))["rate"] == 30.0


async def test_node_that_is_not_there_is_told(tmp_path: Path) -> None:
    async with lab_with(tmp_path, CAMERA) as lab:
        await lab.told(lambda text: "parameters of /lab/camera: it is not there" in text)
        with pytest.raises(RemoteError, match="nobody offers the ROS service /lab/camera/list"):
            await lab.call("lab/camera/settings/list", {})


async def test_our_settings_are_parameters_to_read(tmp_path: Path) -> None:
    async with (
        lab_with(tmp_path, node="fleet", namespace="/lab") as lab,
        peer(lab, "ask_parameters", "/lab/fleet", "domain_id") as asking,
    ):
        _, names = await asking.until("names")
        assert {"automatic", "domain_id", "node", "types", "use_sim_time"} <= set(names)
        assert await asking.until("values") == ["values", [[2, lab.domain_id, ""]]]
        assert await asking.until("types") == ["types", []]  # one of them is unknown
        _, successful, reason = await asking.until("set")
    assert not successful
    assert reason == ("domain_id is read-only: set VERTEBRA_ROS2_DOMAIN_ID and restart the service")
