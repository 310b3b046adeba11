"""Keys, tokens and attachments of rmw_zenoh: as its design document prints them, and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vertebra.errors import DecodeError, NameMappingError
from vertebra.keys import check_key_expression
from vertebra.ros2.qos import LATCHED, Qos
from vertebra.ros2.rmw_zenoh import wire
from vertebra.ros2.rmw_zenoh.wire import ANY_HASH, NO_HASH, Attachment, Token

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
ADD_HASH = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
STRING = f"std_msgs::msg::dds_::String_/{STRING_HASH}"
ADD = f"example_interfaces::srv::dds_::AddTwoInts_/{ADD_HASH}"

TALKER = Token(
    domain_id=2,
    session="8b20917502ee955ac4476e0266340d5c",
    node_id="0",
    entity_id="10",
    kind="MP",
    node="talker",
    name="/chatter",
    type="std_msgs/msg/String",
    type_hash=STRING_HASH,
    qos=Qos(depth=7),
)
TALKER_KEY = (
    f"@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/{STRING}/::,7:,:,:,,"
)
PRINTED = {
    "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener": Token(
        domain_id=2,
        session="aac3178e146ba6f1fc6e6a4085e77f21",
        node_id="0",
        entity_id="0",
        kind="NN",
        node="listener",
    ),
    TALKER_KEY: TALKER,
    "@ros2_lv/2/f9980ee0495eaafb3e38f0d19e2eae12/0/10/SS/%/%/add_two_ints_server/%add_two_ints/"
    f"{ADD}/::,10:,:,:,,": Token(
        domain_id=2,
        session="f9980ee0495eaafb3e38f0d19e2eae12",
        node_id="0",
        entity_id="10",
        kind="SS",
        node="add_two_ints_server",
        name="/add_two_ints",
        type="example_interfaces/srv/AddTwoInts",
        type_hash=ADD_HASH,
    ),
}
GID = bytes.fromhex("c29cc39cb8e7c8d34f4a1c3f7e2ad1a5")
ATTACHMENT = Attachment(sequence=258, sent_ns=1_700_000_000_123_456_789, gid=GID)
ATTACHMENT_BYTES = bytes.fromhex(
    "0201000000000000"  # 258
    "15cd853dfe9c9717"  # 2023-11-14 22:13:20.123456789 UTC
    "10"  # 16 bytes follow
) + GID  # fmt: skip

WORDS = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
NAMES = st.lists(WORDS, min_size=1, max_size=4).map(lambda words: "/" + "/".join(words))
QOS = st.builds(
    Qos,
    reliability=st.sampled_from(["reliable", "best_effort"]),
    durability=st.sampled_from(["volatile", "transient_local"]),
    depth=st.integers(1, 100_000),
)
ENDPOINTS = st.builds(
    Token,
    domain_id=st.integers(0, 232),
    session=st.from_regex(r"[1-9a-f][0-9a-f]{0,31}", fullmatch=True),
    node_id=st.integers(0, 99).map(str),
    entity_id=st.integers(0, 9999).map(str),
    kind=st.sampled_from(["MP", "MS", "SS", "SC"]),
    enclave=st.just("/") | NAMES,
    namespace=st.just("/") | NAMES,
    node=WORDS,
    name=NAMES,
    type=st.sampled_from(["std_msgs/msg/String", "a_b/srv/C", "nav2_msgs/action/X_SendGoal"]),
    type_hash=st.just("") | st.from_regex(r"RIHS01_[0-9a-f]{64}", fullmatch=True),
    qos=QOS,
)


@pytest.mark.parametrize(
    ("key", "given"),
    [
        (f"0/chatter/{STRING}", (0, "/chatter", "std_msgs/msg/String", STRING_HASH)),
        (f"0/robot1/chatter/{STRING}", (0, "/robot1/chatter", "std_msgs/msg/String", STRING_HASH)),
        (f"2/add_two_ints/{ADD}",
         (2, "/add_two_ints", "example_interfaces/srv/AddTwoInts", ADD_HASH)),
        (f"0/chatter/std_msgs::msg::dds_::String_/{NO_HASH}",
         (0, "/chatter", "std_msgs/msg/String", "")),
        ("0/chatter/std_msgs::msg::dds_::String_/*",
         (0, "/chatter", "std_msgs/msg/String", ANY_HASH)),
    ],
)  # fmt: skip
def test_keys(key: str, given: tuple[int, str, str, str]) -> None:
    assert wire.key_of(*given) == key


@pytest.mark.parametrize("key", PRINTED)
def test_printed_tokens(key: str) -> None:
    assert wire.read_token(key) == PRINTED[key]
    assert PRINTED[key].key == key


@given(ENDPOINTS)
def test_token_comes_back_from_its_key(token: Token) -> None:
    assert wire.read_token(token.key) == token
    check_key_expression(token.key)


@given(ENDPOINTS, ENDPOINTS)
def test_no_two_endpoints_share_a_key(one: Token, other: Token) -> None:
    assert (one.key == other.key) == (one == other)


@given(st.text(alphabet="@ros2_lv/09MPSN%:,abc*", max_size=200) | st.text(max_size=80))
def test_what_is_no_token_is_refused(text: str) -> None:
    try:
        wire.read_token(text)
    except (DecodeError, NameMappingError):
        return
    assert text.startswith("@ros2_lv/")


@pytest.mark.parametrize("cut", range(1, 13))
def test_token_that_ends_early_is_refused(cut: int) -> None:
    with pytest.raises(DecodeError):
        wire.read_token("/".join(TALKER_KEY.split("/")[:-cut]))


@pytest.mark.parametrize(
    "key",
    [
        TALKER_KEY.replace("/MP/", "/XX/"),
        TALKER_KEY.replace("@ros2_lv/2/", "@ros2_lv/two/"),
        TALKER_KEY.replace("8b20917502ee955ac4476e0266340d5c", "someone"),
        TALKER_KEY.replace("dds_::String_", "String"),
        TALKER_KEY.replace("::,7:,:,:,,", "::,x:,:,:,,"),
        TALKER_KEY.replace("::,7:,:,:,,", "nothing"),
        TALKER_KEY.replace("::,7:,:,:,,", f"::,{'9' * 5000}:,:,:,,"),
    ],
)
def test_faulty_token_is_refused_with_its_text(key: str) -> None:
    with pytest.raises(DecodeError, match=r"rmw_zenoh|endpoint|no type of ROS"):
        wire.read_token(key)
    with pytest.raises(NameMappingError):
        wire.read_token(TALKER_KEY.replace("%chatter", "%1st"))


def test_token_of_a_later_release_is_read() -> None:
    assert wire.read_token(f"{TALKER_KEY}/cpu,cuda") == TALKER


def test_endpoint_of_a_topic() -> None:
    endpoint = wire.endpoint_of(TALKER, TALKER_KEY)
    assert (endpoint.kind, endpoint.role, endpoint.name) == ("writer", "topic", "/chatter")
    assert (endpoint.type, endpoint.type_hash) == ("std_msgs/msg/String", STRING_HASH)
    assert (endpoint.qos, endpoint.node) == (Qos(depth=7), "/talker")
    assert endpoint.gid == bytes.fromhex(TALKER.session) + wire.gid_of(TALKER_KEY)


def test_gid_is_the_hash_of_the_token() -> None:
    node, talker = list(PRINTED)[:2]
    assert wire.gid_of(node).hex() == "49877999dacb858702d11ac823785912"
    assert wire.gid_of(talker).hex() == "ac170f31eadcd9ff0cd86d7a17907d1c"


@pytest.mark.parametrize(
    ("text", "qos"),
    [
        ("::,10:,:,:,,", Qos()),
        ("::,:,:,:,,", Qos(depth=42)),
        ("2::,5:,:,:,,", Qos(reliability="best_effort", depth=5)),
        (":1:,1:,:,:,,", LATCHED),
    ],
)
def test_qos(text: str, qos: Qos) -> None:
    assert wire.qos_text(qos) == text
    assert wire.read_qos(text) == qos


@pytest.mark.parametrize(
    ("text", "qos"),
    [
        ("1:2:1,10:,:,:1,,", Qos()),  # all in words, as others write it
        ("::2,10:,:,:,,", Qos()),  # keep_all
        ("::,10:1,5:,:3,2,0", Qos()),  # deadline and lease
    ],
)
def test_qos_that_we_do_not_write(text: str, qos: Qos) -> None:
    assert wire.read_qos(text) == qos


def test_attachment() -> None:
    assert ATTACHMENT.encode() == ATTACHMENT_BYTES
    assert wire.read_attachment(ATTACHMENT_BYTES) == ATTACHMENT


def test_attachment_of_an_early_release() -> None:
    numbers, gid = ATTACHMENT_BYTES[:16], ATTACHMENT_BYTES[16:]
    named = (
        b"\x0fsequence_number" + numbers[:8]
        + b"\x10source_timestamp" + numbers[8:]
        + b"\x0asource_gid" + gid
    )  # fmt: skip
    assert wire.read_attachment(named) == ATTACHMENT


@given(st.integers(1, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachment_comes_back(sequence: int, sent_ns: int, gid: bytes) -> None:
    attachment = Attachment(sequence, sent_ns, gid)
    assert wire.read_attachment(attachment.encode()) == attachment


@pytest.mark.parametrize("size", range(len(ATTACHMENT_BYTES)))
def test_damaged_attachment_is_refused(size: int) -> None:
    with pytest.raises(DecodeError, match=f"^{size} bytes"):
        wire.read_attachment(ATTACHMENT_BYTES[:size])


@given(st.binary(max_size=80))
def test_noise_is_an_attachment_or_refused(data: bytes) -> None:
    try:
        wire.read_attachment(data)
    except DecodeError:
        return
    assert len(data) >= 17
