"""The table of names: what is granted, refused, bounded, and which ports it wants connected.

Its replies in YARP's own words are in conformance/test_yarp_sessions.py.
"""

from __future__ import annotations

import pytest

from vertebra.yarp.naming.nametable import NameTable
from vertebra.yarp.naming.subscriptions import Match
from vertebra.yarp.protocol.bottle import Value, Vocab

OK = [Vocab("ok")]


def ask(table: NameTable, *words: Value) -> str:
    reply = table.answer(words, "10.0.0.9")
    assert isinstance(reply, bytes)
    return reply.decode().removesuffix("*** end of message\r\n").strip()


def test_a_port_gets_its_former_tcp_port_back_and_no_other_gets_it_meanwhile() -> None:
    table = NameTable()
    first = ask(table, "register", "/a")
    ask(table, "unregister", "/a")
    assert "port 10003" in ask(table, "register", "/b")
    assert ask(table, "register", "/a") == first
    assert "port 10002" in first


def test_tcp_ports_run_out_and_are_used_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vertebra.yarp.naming.nametable._MAX_PORTS", 3)
    table = NameTable()
    for name in ("/a", "/b", "/c"):
        assert ask(table, "register", name)
    assert ask(table, "register", "/d") == ""
    ask(table, "unregister", "/b")
    assert ask(table, "register", "/d").endswith("port 10003 type tcp")
    assert ask(table, "register", "/a", "tcp", "h", 17).endswith("port 17 type tcp")


@pytest.mark.parametrize("tcp_port", [-2, 65536, 1 << 31])
def test_a_tcp_port_that_cannot_be_is_not_registered(tcp_port: Value) -> None:
    table = NameTable()
    assert ask(table, "register", "/a", "tcp", "127.0.0.1", tcp_port) == ""
    assert ask(table, "query", "/a") == ""


def test_a_prefix_matches_whole_parts_of_names() -> None:
    table = NameTable()
    for name in ("/py", "/py/a", "/pyx"):
        ask(table, "register", name)
    assert ask(table, "list", "/py").count("registration") == 2
    assert ask(table, "list").count("registration") == 3


def test_properties_are_bounded_and_need_a_port() -> None:
    table = NameTable()
    assert ask(table, "set", "/a", "k", "v") == ""
    ask(table, "register", "/a")
    for number in range(200):
        ask(table, "set", "/a", f"k{number}", number)
    assert ask(table, "get", "/a", "k99") == "port /a property k99 = 99"
    assert ask(table, "get", "/a", "k100") == "port /a property k100 ="


@pytest.mark.parametrize("tcp_port", [0, -1, "...", "many", 2.5])
def test_where_no_tcp_port_is_named_one_is_given(tcp_port: Value) -> None:
    assert "port 10002 " in ask(NameTable(), "register", "/a", "tcp", "127.0.0.1", tcp_port)


def test_properties_do_not_grow_without_end() -> None:
    table = NameTable()
    ask(table, "register", "/a")
    ask(table, "set", "/a", "k", "x" * 20_000)
    assert ask(table, "get", "/a", "k") == "port /a property k ="


@pytest.mark.parametrize("name", ["/a b", '/"', "/a\r\nregistration", "", "/(x)", "/" * 2000])
def test_names_that_would_break_the_lines_of_replies_are_refused(name: str) -> None:
    table = NameTable()
    assert ask(table, "register", name) == ""
    assert ask(table, "list") == ""


def test_a_value_cannot_end_a_line() -> None:
    table = NameTable()
    ask(table, "register", "/a")
    assert ask(table, "set", "/a", "k", "v\r\nw") == r"port /a property k = v\r\nw"


def test_names_are_quoted_in_bot_replies_only() -> None:
    table = NameTable()
    ask(table, "register", "/a", "tcp", "h", 17)
    assert table.answer(["bot", "query", "/a"], "") == [
        "port", ["name", "/a"], ["ip", "h"], ["port_number", 17], ["carrier", "tcp"],
    ]  # fmt: skip
    assert ask(table, "query", "/a") == "registration name /a ip h port 17 type tcp"
    assert table.answer(["query", "/a", ["format", "json"]], "") == table.answer(
        ["bot", "query", "/a"], ""
    )


def test_bot_properties_are_values() -> None:
    table = NameTable()
    table.answer(["register", "/a"], "h")
    # yarpserver 3.12.3 answers `"1 2" 1.5 17 vo "x y"`: several values in one are a string.
    request: list[Value] = ["bot", "set", "/a", "foo", "x y", 17, [1, 2], Vocab("vo"), 1.5]
    assert table.answer(request, "") == ["1 2", 1.5, 17, "vo", "x y"]
    assert table.answer(["bot", "set", "/nope", "k", 1], "") == []
    assert table.answer(["bot", "get", "/nope", "k"], "") == []


def test_some_bot_requests_are_answered_in_lines_all_the_same() -> None:
    table = NameTable()
    assert ask(table, "bot", "register", "/a", "tcp", "h", 17).splitlines() == [
        "port", "name /a", "ip h", "port_number 17", "carrier tcp",
    ]  # fmt: skip
    assert ask(table, "bot", "unregister", "/a").splitlines() == ["port", "error -2 port not known"]
    assert ask(table, "bot", "gc") == "garbage collection done."
    assert ask(table, "bot", "frobnicate") == ""


def test_an_address_is_chosen_by_network() -> None:
    table = NameTable()
    ask(table, "register", "/a", "tcp", "10.0.0.7", 17)
    ask(table, "set", "/a", "ips", "10.0.0.7", "192.168.1.7")
    assert " ip 192.168.1.7 " in ask(table, "query", "/net=192.168/a")
    assert " ip 10.0.0.7 " in ask(table, "query", "/net=172/a")


def test_what_a_port_owns_goes_with_it() -> None:
    table = NameTable()
    for name in ("/a", "/group", "/b"):
        ask(table, "register", name)
    table.answer(["bot", "set", "/a", "owns", "/group"], "")
    table.answer(["set", "/group", "owns", "/a"], "")  # a ring is no trap
    ask(table, "unregister", "/a")
    assert ask(table, "list").split()[2::9] == ["/b"]


def test_multicast_groups_are_given_once() -> None:
    table = NameTable()
    hosts = [ask(table, "register", "...", "mcast", "...", "...").split()[4] for _ in range(300)]
    assert hosts[:2] == ["224.1.1.3", "224.1.1.4"]
    assert len({*hosts}) == 300
    assert "224.1.2.1" in hosts
    ask(table, "unregister", "/tmp/port/1")
    assert "ip 224.1.1.3 " in ask(table, "register", "...", "mcast")


def test_runners_are_the_ports_with_that_property() -> None:
    table = NameTable()
    ask(table, "register", "/run")
    ask(table, "register", "/a")
    ask(table, "set", "/run", "yarprun", "true")
    assert ask(table, "runners").startswith("registration name /run ")
    assert ask(table, "runners").count("registration") == 1


# --- persistent connections ---


class Lab:
    """A table, and what it wants to be connected."""

    def __init__(self) -> None:
        self.matches: list[Match] = []
        self.table = NameTable(self.matches.append)

    def ask(self, *words: Value) -> object:
        return self.table.answer(words, "h")

    def start(self, *names: str) -> None:
        for name in names:
            self.ask("register", name)
            self.ask("announce", name)

    def matched(self) -> list[tuple[str, str, str]]:
        found = [(each.source, each.dest, each.carrier) for each in self.matches]
        self.matches.clear()
        return found


@pytest.fixture
def lab() -> Lab:
    return Lab()


def test_ports_are_connected_when_both_are_announced(lab: Lab) -> None:
    assert lab.ask("subscribe", "/x", "fast_tcp://y") == OK
    lab.start("/x")
    lab.ask("register", "/y")
    assert lab.matched() == []
    lab.ask("announce", "/y")
    assert lab.matched() == [("/x", "/y", "fast_tcp")]
    assert lab.ask("subscribe", "/x") == [
        "subscriptions", ["subscription", ["src", "/x"], ["dest", "fast_tcp://y"]],
    ]  # fmt: skip


def test_a_port_that_starts_again_is_connected_again_afresh(lab: Lab) -> None:
    lab.start("/x", "/y")
    lab.ask("subscribe", "/x", "/y")
    assert lab.matches == [Match("/x", "/y", "tcp", afresh=False)]
    lab.ask("register", "/y")  # killed and restarted: it has not unregistered
    assert len(lab.matches) == 1
    lab.ask("announce", "/y")
    assert lab.matches[1:] == [Match("/x", "/y", "tcp", afresh=True)]


def test_a_rumour_of_death_is_not_believed(lab: Lab) -> None:
    lab.start("/x", "/y")
    assert lab.ask("announce", "/y", 0) == OK
    lab.ask("subscribe", "/x", "/y")
    assert lab.matched() == [("/x", "/y", "tcp")]


def test_unsubscribed_ports_are_left_alone(lab: Lab) -> None:
    lab.ask("subscribe", "/x", "tcp://y")
    assert lab.ask("unsubscribe", "/x", "/y") == OK
    lab.start("/x", "/y")
    assert lab.matched() == []
    assert lab.ask("subscribe") == ["subscriptions"]


def test_a_topic_joins_all_that_feed_it_with_all_that_it_feeds(lab: Lab) -> None:
    lab.start("/a", "/b", "/c")
    lab.ask("subscribe", "/a", "topic://t")
    lab.ask("subscribe", "/b", "topic://t")
    assert lab.matched() == []
    lab.ask("subscribe", "topic://t", "udp://c")
    assert lab.matched() == [("/a", "/c", "udp"), ("/b", "/c", "udp")]
    assert lab.ask("topic") == ["/t"]
    assert lab.ask("subscribe", "/a") == [
        "subscriptions", ["subscription", ["src", "/a"], ["dest", "topic://t"], ["topic", 0, 1]],
    ]  # fmt: skip
    lab.start("/c")
    assert len(lab.matched()) == 2
    lab.ask("untopic", "/t")
    lab.start("/c")
    assert lab.matched() == []
    lab.ask("topic", "/t")
    assert len(lab.matched()) == 2


@pytest.mark.parametrize(("mode", "keeper"), [("from", "/x"), ("to", "/y")])
def test_a_subscription_may_end_with_one_of_its_ports(lab: Lab, mode: str, keeper: str) -> None:
    lab.ask("subscribe", "/x", "/y", mode)
    assert lab.ask("subscribe") == ["subscriptions"]  # it is not there: it has ended already
    lab.start("/x", "/y")
    lab.ask("subscribe", "/x", "/y", mode)
    assert lab.ask("subscribe") == [
        "subscriptions", ["subscription", ["src", "/x"], ["dest", "/y"], ["mode", mode]],
    ]  # fmt: skip
    lab.ask("unregister", ({"/x", "/y"} - {keeper}).pop())
    assert lab.ask("subscribe") != ["subscriptions"]
    lab.ask("unregister", keeper)
    assert lab.ask("subscribe") == ["subscriptions"]


def test_subscriptions_and_topics_are_bounded(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vertebra.yarp.naming.subscriptions._MAX_SUBSCRIPTIONS", 2)
    monkeypatch.setattr("vertebra.yarp.naming.subscriptions._MAX_TOPICS", 1)
    assert [lab.ask("subscribe", "/x", name) for name in ("/a", "/b", "/a")] == [OK] * 3
    assert lab.ask("subscribe", "/x", "/c") == [Vocab("fail")]
    assert lab.ask("topic", "/t") == OK
    assert lab.ask("topic", "/u") == [Vocab("fail")]
    assert lab.ask("subscribe", "/x", "topic://u") == [Vocab("fail")]
