"""The WebSocket protocol without a WebSocket."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.bus import Delivery
from vertebra_gateway.problems import Problem
from vertebra_gateway.ws_protocol import (
    MAX_CALLS,
    MAX_SUBSCRIPTIONS,
    MAX_TEXT_BYTES,
    Acknowledge,
    Call,
    Conversation,
    End,
    Subscribe,
    Unsubscribe,
    data_message,
    drops,
    error,
    reply,
    robots,
    shared_head,
    subscribed,
    unsubscribed,
)

NOW_NS = 1_700_000_000_000_000_001


def conversation() -> Conversation:
    return Conversation(lambda: NOW_NS)


def send(talk: Conversation, op: str, **members: Any) -> Any:
    outcome = talk.receive(json.dumps({"op": op, **members}))
    return json.loads(outcome) if isinstance(outcome, str) else outcome


def test_subscribe_with_all_options() -> None:
    order = send(
        conversation(),
        "subscribe",
        id=7,
        key="vizzy/**",
        depth=3,
        max_rate_hz=10,
        form="json",
        window=2,
    )
    assert isinstance(order, Subscribe)
    assert (order.id, order.key, order.form, order.max_rate_hz, order.window) == (
        7,
        "vizzy/**",
        "json",
        10.0,
        2,
    )
    assert order.buffer() == Delivery.latest(3)


def test_defaults_of_subscribe() -> None:
    talk = conversation()
    order = send(talk, "subscribe", id=1, key="a")
    assert (order.form, order.buffer()) == ("frame", Delivery.latest(1))
    assert send(talk, "subscribe", id=2, key="a", delivery="queue").buffer() == Delivery.queue(64)


def test_ping_tells_our_time_and_repeats_theirs() -> None:
    pong = send(conversation(), "ping", id=3, client_ns="1700000000000000000")
    assert pong == {
        "op": "pong",
        "id": 3,
        "client_ns": "1700000000000000000",
        "server_ns": str(NOW_NS),
    }


def test_a_subscription_lives_from_subscribe_to_unsubscribe() -> None:
    talk = conversation()
    assert send(talk, "ack", id=1)["status"] == 404
    assert send(talk, "unsubscribe", id=1)["status"] == 404
    assert isinstance(send(talk, "subscribe", id=1, key="a"), Subscribe)
    assert send(talk, "subscribe", id=1, key="b")["status"] == 422
    assert isinstance(send(talk, "ack", id=1), Acknowledge)
    assert isinstance(send(talk, "unsubscribe", id=1), Unsubscribe)
    assert isinstance(send(talk, "subscribe", id=1, key="b"), Subscribe)


def test_a_call_has_its_id_until_it_ends() -> None:
    talk = conversation()
    order = send(talk, "call", id=1, robot="vizzy", path="head/stop")
    assert isinstance(order, Call)
    assert (order.body, order.timeout_s) == ({}, None)
    assert send(talk, "call", id=1, robot="vizzy", path="head/stop")["status"] == 422
    talk.call_ended(1)
    assert isinstance(send(talk, "call", id=1, robot="vizzy", path="head/stop"), Call)


def test_too_many_calls_are_refused_and_too_many_subscriptions_end_it() -> None:
    talk = conversation()
    for number in range(1, MAX_CALLS + 1):
        assert isinstance(send(talk, "call", id=number, robot="r", path="p"), Call)
    assert send(talk, "call", id=MAX_CALLS + 1, robot="r", path="p")["status"] == 429
    for number in range(1, MAX_SUBSCRIPTIONS + 1):
        assert isinstance(send(talk, "subscribe", id=number, key="a"), Subscribe)
    end = send(talk, "subscribe", id=MAX_SUBSCRIPTIONS + 1, key="a")
    assert isinstance(end, End)
    assert (end.code, "256" in end.reason) == (1008, True)


def test_a_message_that_is_too_long_ends_it() -> None:
    end = conversation().receive(" " * (MAX_TEXT_BYTES + 1))
    assert isinstance(end, End)
    assert (end.code, len(end.reason.encode()) <= 123) == (1009, True)


@pytest.mark.parametrize(
    ("text", "id_"),
    [
        ("", None),
        ("nonsense", None),
        ("[]", None),
        ("{}", None),
        ('{"op": "dance", "id": 5}', 5),
        ('{"op": "ping"}', None),
        ('{"op": "ping", "id": 5}', 5),
        ('{"op": "ping", "id": 0, "client_ns": 1}', None),
        ('{"op": "ping", "id": -1, "client_ns": 1}', None),
        ('{"op": "ping", "id": 4294967296, "client_ns": 1}', None),
        ('{"op": "ping", "id": "5", "client_ns": 1}', None),
        ('{"op": "ping", "id": 5, "client_ns": null}', 5),
        ('{"op": "subscribe", "id": 5, "key": "/a"}', 5),
        ('{"op": "subscribe", "id": 5, "key": ""}', 5),
        ('{"op": "subscribe", "id": 5, "key": 7}', 5),
        ('{"op": "subscribe", "id": 5, "key": "a", "depth": 0}', 5),
        ('{"op": "subscribe", "id": 5, "key": "a", "depth": 1000000}', 5),
        ('{"op": "subscribe", "id": 5, "key": "a", "form": "png"}', 5),
        ('{"op": "subscribe", "id": 5, "key": "a", "max_rate_hz": 0}', 5),
        ('{"op": "subscribe", "id": 5, "key": "a", "max_rate_hz": 1e999}', 5),
        ('{"op": "subscribe", "id": 5, "key": "a", "max_rate_hz": 1, "delivery": "queue"}', 5),
        ('{"op": "subscribe", "id": 5, "key": "a", "window": 0}', 5),
        ('{"op": "call", "id": 5, "robot": "r"}', 5),
        ('{"op": "call", "id": 5, "robot": "r", "path": "p", "timeout_s": 0}', 5),
        pytest.param("[" * 100_000, None, id="deep"),
        (b"\x00", None),
    ],
)
def test_what_cannot_be_read_is_answered_with_an_error(text: str | bytes, id_: int | None) -> None:
    talk = conversation()
    answer = talk.receive(text)
    assert isinstance(answer, str)
    document = json.loads(answer)
    assert (document["op"], document["id"], document["status"]) == ("error", id_, 422)
    assert document["detail"]
    assert not talk.subscriptions
    assert not talk.calls


ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)
NEAR_MESSAGES = st.fixed_dictionaries(
    {"op": st.sampled_from(["subscribe", "unsubscribe", "ack", "call", "ping", "x"]) | ANY_JSON},
    optional={
        "id": st.integers(1, 4) | ANY_JSON,
        "key": st.sampled_from(["a", "a/**", "/"]) | st.text() | ANY_JSON,
        "delivery": st.sampled_from(["latest", "queue"]) | ANY_JSON,
        "depth": st.integers(-1, 5000) | ANY_JSON,
        "max_rate_hz": st.floats() | ANY_JSON,
        "form": st.sampled_from(["frame", "json", "jpeg"]) | ANY_JSON,
        "window": st.integers(-1, 3) | ANY_JSON,
        "robot": st.text() | ANY_JSON,
        "path": st.text() | ANY_JSON,
        "body": ANY_JSON,
        "timeout_s": st.floats() | ANY_JSON,
        "client_ns": ANY_JSON,
    },
)
ANY_TEXT = st.text() | st.binary() | (ANY_JSON | NEAR_MESSAGES).map(json.dumps)


@given(st.lists(ANY_TEXT, max_size=20))
def test_nothing_that_is_sent_breaks_the_conversation(texts: list[str | bytes]) -> None:
    talk = conversation()
    for text in texts:
        outcome = talk.receive(text)
        if isinstance(outcome, str):
            document = json.loads(outcome)
            assert document["op"] in ("error", "pong")
        elif isinstance(outcome, Subscribe):
            assert outcome.id in talk.subscriptions
            assert outcome.buffer().depth >= 1
        elif isinstance(outcome, Call):
            assert outcome.id in talk.calls
        else:
            assert isinstance(outcome, Unsubscribe | Acknowledge | End)


def test_what_the_gateway_says() -> None:
    assert json.loads(subscribed(1)) == {"op": "subscribed", "id": 1}
    assert json.loads(unsubscribed(1)) == {"op": "unsubscribed", "id": 1}
    assert json.loads(reply(1, [2])) == {"op": "reply", "id": 1, "body": [2]}
    assert json.loads(drops(1, 2, 3)) == {"op": "drops", "id": 1, "dropped": 2, "lost": 3}
    assert json.loads(robots([])) == {"op": "robots", "robots": []}
    problem = Problem(status=422, detail="no", more={"joint": "pan"})
    assert json.loads(error(1, problem)) == {
        "op": "error",
        "id": 1,
        "type": "about:blank",
        "title": "Unprocessable Content",
        "status": 422,
        "detail": "no",
        "joint": "pan",
    }


def test_golden_data_message() -> None:
    head = shared_head("a/ü", 'x;"1"', 123, 99)
    message = data_message(0x01020304, head, 5, b"payload")
    expected_head = (
        '{"key":"a/ü","encoding":"x;\\"1\\"","sent_ns":"123","captured_ns":"99","dropped":5}'
    ).encode()
    assert message == (
        b"\x04\x03\x02\x01"  # subscription
        + len(expected_head).to_bytes(4, "little")
        + expected_head
        + bytes(-(8 + len(expected_head)) % 64)
        + b"payload"
    )


@given(
    st.integers(1, 2**32 - 1),
    st.tuples(st.text(), st.text(), st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1)),
    st.integers(0, 2**53),
    st.binary(max_size=200),
)
def test_data_messages_can_be_read_back(
    subscription: int, sample: tuple[str, str, int, int], dropped: int, payload: bytes
) -> None:
    key, encoding, sent_ns, captured_ns = sample
    head = shared_head(key, encoding, sent_ns, captured_ns)
    message = data_message(subscription, head, dropped, payload)
    length = int.from_bytes(message[4:8], "little")
    start = (8 + length + 63) // 64 * 64
    assert int.from_bytes(message[:4], "little") == subscription
    assert json.loads(message[8 : 8 + length]) == {
        "key": key,
        "encoding": encoding,
        "sent_ns": str(sent_ns),
        "captured_ns": str(captured_ns),
        "dropped": dropped,
    }
    assert message[8 + length : start] == bytes(start - 8 - length)
    assert message[start:] == payload
