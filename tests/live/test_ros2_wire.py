"""Keys, tokens, attachments and type hashes of rmw_zenoh, against bytes and words written from its documents."""

import pytest

from mapweave.live.messages import RefusedError
from mapweave.live.ros2 import wire
from mapweave.live.ros2.wire import NO_HASH, Attachment, Entity, Qos, Topic, mangled_type

from . import ros_peer

GID = bytes(range(16))
PLAIN = bytes.fromhex("0700000000000000 15cd5b0700000000 10 000102030405060708090a0b0c0d0e0f")
NAMED = bytes.fromhex(
    "0f 73657175656e63655f6e756d626572 0700000000000000"
    "10 736f757263655f74696d657374616d70 15cd5b0700000000"
    "0a 736f757263655f676964 10 000102030405060708090a0b0c0d0e0f"
)
SCAN_HASH = "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"
TOKEN = (
    "@ros2_lv/3/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%tb1/driver/%tb1%scan/"
    f"sensor_msgs::msg::dds_::LaserScan_/{SCAN_HASH}/2::,5:,:,:,,"
)


BRIDGED = (
    f"@/aac3178e146ba6f1fc6e6a4085e77f21/@ros2_lv/MP/tb1§scan/sensor_msgs§msg§LaserScan/:0:0:0,5:typehash={SCAN_HASH};"
)


@pytest.mark.parametrize("data", [PLAIN, NAMED])
def test_both_forms_of_an_attachment_are_read(data):
    assert Attachment.decode(data) == Attachment(7, 123456789, GID)


def test_an_attachment_is_written_as_three_fields_in_a_row():
    assert Attachment(7, 123456789, GID).encode() == PLAIN


@pytest.mark.parametrize(
    "data", [b"", PLAIN[:-1], PLAIN + b"\0", PLAIN[:16] + b"\x0f" + PLAIN[17:], NAMED[:-1], NAMED[1:], b"\xff" * 33]
)
def test_other_attachments_are_refused(data):
    with pytest.raises(RefusedError, match="attachment"):
        Attachment.decode(data)


def test_a_token_says_who_publishes_what():
    read = Entity.read(TOKEN)
    scan = Topic("/tb1/scan", "sensor_msgs/msg/LaserScan", SCAN_HASH, Qos(reliable=False, depth=5))
    assert read == Entity(3, "aac3178e146ba6f1fc6e6a4085e77f21", 0, 10, "MP", "/tb1", "driver", scan)
    assert read.token() == TOKEN
    assert scan.key(3) == f"3/tb1/scan/sensor_msgs::msg::dds_::LaserScan_/{SCAN_HASH}"


def test_a_bridge_says_what_it_passes_on():
    read = Entity.read(BRIDGED)
    scan = Topic("/tb1/scan", "sensor_msgs/msg/LaserScan", SCAN_HASH, Qos(reliable=False, depth=5), bridged=True)
    assert read == Entity(0, "aac3178e146ba6f1fc6e6a4085e77f21", 0, 0, "MP", "/", "zenoh-bridge-ros2dds", scan)
    assert scan.key(3) == "tb1/scan"
    assert read.token() == BRIDGED.partition(":typehash")[0]
    latched = Entity.read(BRIDGED.replace("/:0:0:0,5", "/K::1:").partition(":typehash")[0]).topic
    assert latched.qos == Qos(transient_local=True)
    assert latched.type_hash == NO_HASH


def test_a_node_at_the_root_has_a_token_without_a_topic():
    said = "@ros2_lv/0/ab/0/0/NN/%/%/listener"
    assert Entity.read(said) == Entity(0, "ab", 0, 0, "NN", "/", "listener")
    assert Entity.read(said).token() == said


def test_two_entities_have_two_gids_of_sixteen_bytes():
    a, b = (Entity(0, "ab", 0, k, "NN", "/", "n").gid() for k in (0, 1))
    assert (len(a), len(b)) == (16, 16)
    assert a != b


@pytest.mark.parametrize(
    ("words", "qos"),
    [
        ("::,:,:,:,,", Qos()),
        (":1:,1:,:,:,,", Qos(transient_local=True, depth=1)),
        ("2::,5:,:,:,,", Qos(reliable=False, depth=5)),
    ],
)
def test_quality_of_service_is_told_where_it_is_not_the_default(words, qos):
    assert str(qos) == words
    assert Qos.read(words) == qos


def test_quality_of_service_spelled_out_is_read():
    assert Qos.read("1:2:1,10:0,0:60,3000:1,0,0") == Qos(depth=10)


@pytest.mark.parametrize(
    "token",
    [
        "",
        "@ros2_lv/0/ab/0/0/NN/%/%",
        "@ros2_lv/x/ab/0/0/NN/%/%/n",
        "@ros2_lv/0/ab/0/0/XX/%/%/n",
        "@ros2_lv/0/ab/0/0/MP/%/%/n",
        "other/0/ab/0/0/NN/%/%/n",
        TOKEN.replace("::msg::", "::"),
        TOKEN.replace("2::,5:,:,:,,", "2"),
        TOKEN.replace("2::,5:,:,:,,", "2::,five:,:,:,,"),
        TOKEN + "/more",
        BRIDGED.replace("/MP/", "/SS/"),
        BRIDGED.replace("§msg§", "§"),
        BRIDGED.replace(":0:0:0,5", ":0"),
        BRIDGED.replace(":0:0:0,5", ":0:0:0,five"),
        BRIDGED + "/more",
    ],
)
def test_what_is_no_token_is_refused(token):
    with pytest.raises(RefusedError, match="no token"):
        Entity.read(token)


def test_type_hashes_are_those_that_ros_2_prints():
    assert {kind: wire.type_hash(kind) for kind in ros_peer.HASHES} == ros_peer.HASHES
    text = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert wire.type_hash("std_msgs/msg/String") == text
    assert mangled_type("std_msgs/msg/String") == "std_msgs::msg::dds_::String_"


def test_a_recorded_transform_is_read_to_the_number():
    recorded = bytes.fromhex(
        "00010000 01000000"  # little-endian CDR; one transform
        "e8030000 00ca9a3b"  # 1000 s and 1000000000 ns
        "05000000 6f646f6d00 000000"  # odom
        "05000000 6261736500 000000"  # base
        "00000000"  # numbers of 8 bytes begin at a multiple of 8
        "000000000000f03f 00000000000000c0 0000000000000000"
        "0000000000000000 0000000000000000 0000000000000000 000000000000f03f"
    )
    (one,) = wire.decode(recorded, wire.TF).transforms
    assert (one.header.frame_id, one.child_frame_id) == ("odom", "base")
    assert (one.header.stamp.sec, one.header.stamp.nanosec) == (1000, 1000000000)
    assert (one.transform.translation.x, one.transform.translation.y, one.transform.rotation.w) == (1.0, -2.0, 1.0)


def test_bytes_that_are_no_message_are_refused_at_every_length():
    whole = ros_peer.scan(5.0, "laser", [1.0, 2.0], 0.0, 0.1, 10.0)
    for n in range(len(whole)):
        with pytest.raises(RefusedError, match="malformed"):
            wire.decode(whole[:n], wire.SCAN)
    assert wire.decode(whole, wire.SCAN).ranges.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("at", [12, 52, 64])  # of the frame's name, of the ranges, of the intensities
def test_lengths_that_cannot_be_are_refused(at):
    whole = bytearray(ros_peer.scan(5.0, "lase", [1.0, 2.0], 0.0, 0.1, 10.0))
    whole[at : at + 4] = b"\xff\xff\xff\xff"
    with pytest.raises(RefusedError, match="malformed"):
        wire.decode(bytes(whole), wire.SCAN)


def test_a_message_beyond_a_mebibyte_is_refused_unread():
    with pytest.raises(RefusedError, match="oversized"):
        wire.decode(bytes((1 << 20) + 1), wire.SCAN)
