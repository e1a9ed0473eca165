"""Heartbeat, NAME and address claim."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interfaces.isobus.address import SELF_CONFIGURED, AddressClaim, encode_claim
from interfaces.isobus.frame import NULL_ADDRESS, decode_identifier
from interfaces.isobus.heartbeat import HeartbeatCheck
from interfaces.isobus.name import AGRICULTURE, TRACTOR_ECU, Name
from tests.interfaces import dbc

MS = 1_000_000


def received(*sequences: int, period_ms: int = 100) -> HeartbeatCheck:
    check = HeartbeatCheck()
    for k, sequence in enumerate(sequences):
        check.receive(k * period_ms * MS, sequence)
    return check


def is_good(*sequences: int) -> bool:
    return received(*sequences).is_good((len(sequences) - 1) * 100 * MS)


def test_no_heartbeat_is_not_good():
    assert not HeartbeatCheck().is_good(0)


@pytest.mark.parametrize("step", range(8))
def test_heartbeat_repeat_and_jump(step):
    assert is_good(10, 10 + step) == (1 <= step <= 3)


@pytest.mark.parametrize(
    ("sequences", "good"),
    [
        ((251, 0, 1), True),
        ((251, 2), True),
        ((251, 3), False),
        ((249, 250, 0), True),
        ((250, 2), True),
        ((250, 3), False),
        ((17, 251, 0), True),  # restart of the sender
        ((251, 251), False),
        ((5, 252), False),
        ((5, 253), False),
        ((5, 254), False),
        ((5, 255), False),
        ((5, 4), False),
    ],
)
def test_sequences(sequences, good):
    assert is_good(*sequences) == good


@pytest.mark.parametrize("gap_ms", [299, 300, 301])
def test_heartbeat_timeout(gap_ms):
    check = received(1, 2)
    assert check.is_good((100 + gap_ms) * MS) == (gap_ms <= 300)
    assert check.receive((100 + gap_ms) * MS, 3) == (gap_ms <= 300)


@pytest.mark.parametrize("count", range(5, 12))
def test_heartbeat_recovery_count(count):
    check = received(1, 1, *range(2, 2 + count))
    assert check.is_good((1 + count) * 100 * MS) == (count >= 8)


def test_heartbeat_recovery_restart():
    assert not is_good(1, 1, *range(2, 9), 8, *range(9, 16))
    assert is_good(1, 1, *range(2, 9), 8, *range(9, 17))


def name(identity: int = 1, self_configurable: int = 1) -> Name:
    return Name(identity, 0, 0, 0, 255, 0, 0, AGRICULTURE, self_configurable)


def test_name_against_the_dbc():
    full = Name(0x155555, 0x2AA, 5, 21, TRACTOR_ECU, 0x55, 10, AGRICULTURE, 1)
    read = dbc.decode("AddressClaimedTractor", encode_claim(full.encode(), 240).data)
    assert read == {
        "Identity": 0x155555, "Manufacturer": 0x2AA, "EcuInstance": 5, "FunctionInstance": 21, "Function": 134,
        "DeviceClass": 0x55, "DeviceClassInstance": 10, "IndustryGroup": 2, "SelfConfigurable": 1,
    }  # fmt: skip
    assert Name.decode(full.encode()) == full


@settings(derandomize=True, max_examples=50)
@given(st.integers(0, (1 << 64) - 1))
def test_name_round_trip(number):
    number &= ~(1 << 48)  # the reserved bit
    assert Name.decode(number).encode() == number


def test_name_field_out_of_range():
    with pytest.raises(ValueError, match="function = 256"):
        Name(1, 0, 0, 0, 256, 0, 0, AGRICULTURE, 1)


@pytest.mark.parametrize("age_ms", [0, 249, 250, 251])
def test_address_valid_after_250_ms(age_ms):
    claim = AddressClaim(name(), 28)
    frame = claim.start(1000 * MS)
    assert frame.identifier == dbc.identifier("AddressClaimedGateway")
    assert claim.address((1000 + age_ms) * MS) == (28 if age_ms >= 250 else None)


def test_no_address_before_start():
    assert AddressClaim(name(), 28).address(0) is None


def test_claim_repeated_against_higher_name():
    claim = AddressClaim(name(5), 28)
    first = claim.start(0)
    assert claim.receive_claim(1, 28, name(6).encode()) == first
    assert claim.address(250 * MS) == 28


def test_new_address_after_lower_name():
    claim = AddressClaim(name(5), 28)
    claim.start(0)
    frame = claim.receive_claim(300 * MS, 28, name(4).encode())
    assert decode_identifier(frame.identifier).source == SELF_CONFIGURED[0]
    assert claim.address(549 * MS) is None
    assert claim.address(550 * MS) == 128


def test_claimed_addresses_are_skipped():
    claim = AddressClaim(name(5), 28)
    claim.start(0)
    claim.receive_claim(0, 128, name(9).encode())
    claim.receive_claim(0, 129, name(10).encode())
    claim.receive_claim(0, 28, name(4).encode())
    assert claim.address(250 * MS) == 130


def test_moved_node_frees_address():
    claim = AddressClaim(name(5), 28)
    claim.start(0)
    claim.receive_claim(0, 128, name(9).encode())
    claim.receive_claim(0, 200, name(9).encode())
    claim.receive_claim(0, 28, name(4).encode())
    assert claim.address(250 * MS) == 128


@pytest.mark.parametrize("self_configurable", [0, 1])
def test_cannot_claim_address_254(self_configurable):
    claim = AddressClaim(name(5000, self_configurable), 28)
    claim.start(0)
    if self_configurable:
        for k, address in enumerate(SELF_CONFIGURED):
            claim.receive_claim(0, address, name(k + 1).encode())
    frame = claim.receive_claim(0, 28, name(4000, self_configurable).encode())
    assert decode_identifier(frame.identifier).source == NULL_ADDRESS
    assert claim.is_refused
    assert claim.address(10_000 * MS) is None
    assert decode_identifier(claim.answer_request().identifier).source == NULL_ADDRESS


def test_duplicate_name_conflict():
    claim = AddressClaim(name(5, 0), 28)
    claim.start(0)
    claim.receive_claim(0, 28, name(5, 0).encode())
    assert claim.is_refused
