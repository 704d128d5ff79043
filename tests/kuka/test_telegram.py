"""Telegrams as public peers put them on the wire, and what a controller would never send."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mbcacq_kuka.rsi.sequence import NEXT, Counts, Sequence
from mbcacq_kuka.rsi.telegram import Composer, Malformed, Parser, scan

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
KUKA_SIMULATOR = (
    b'<Rob TYPE="KUKA"><RIst X="0.0" Y="0.0" Z="0.0" A="0.0" B="0.0" C="0.0"/><AIPos A1="0.0" A2="-90.0" A3="90.0" A4="0.5" A5="1.5" A6="2.5"/>'
    b'<EIPos E1="0.0" E2="0.0" E3="0.0" E4="0.0" E5="0.0" E6="0.0"/><Delay D="0"/><IPOC>0</IPOC></Rob>'
)
RSIPI_SERVER = (
    b'<Rob Type="KUKA"><RIst X="1.0" Y="2.0" Z="3.0" A="0.0" B="0.0" C="0.0" /><RSol X="0.0" Y="0.0" Z="0.0" A="0.0" B="0.0" C="0.0" />'
    b'<AIPos A1="1.0" A2="2.0" A3="3.0" A4="4.0" A5="5.0" A6="6.0" /><ASPos A1="1.0" A2="2.0" A3="3.0" A4="4.0" A5="5.0" A6="6.0" />'
    b'<Delay D="0" /><DiL>0</DiL><Digout o1="0.00" o2="0.00" o3="0.00" /><Source1>0.0</Source1><DoutW>0</DoutW>'
    b'<Tech C11="0.00" C12="0.00" C110="0.00" /><IPOC>123456</IPOC></Rob>'
)


def axes(parser, element, row):
    return [row[i] for i in parser.slots(element, AXES)]


def test_kukas_simulator():
    parser = Parser(KUKA_SIMULATOR)
    ipoc, row = parser.parse(KUKA_SIMULATOR)
    assert ipoc == b"0"
    assert axes(parser, "AIPos", row) == [0.0, -90.0, 90.0, 0.5, 1.5, 2.5]


def test_rsipi_server():
    parser = Parser(RSIPI_SERVER)
    ipoc, row = parser.parse(RSIPI_SERVER)
    assert ipoc == b"123456"
    assert axes(parser, "AIPos", row) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert {"Tech.C110", "Digout.o1", "DiL", "Source1"} <= set(parser.names)


def test_gpio_attributes_that_are_no_xml_names():
    telegram = b'<Rob Type="KUKA"><AIPos A1="1" A2="2" A3="3" A4="4" A5="5" A6="6"/><GPIO 01="1" 02="0"/><IPOC>4208163634</IPOC></Rob>'
    parser = Parser(telegram)
    row = dict(zip(parser.names, parser.parse(telegram)[1], strict=True))
    assert (row["GPIO.01"], row["GPIO.02"], row["IPOC"]) == (1.0, 0.0, 4208163634.0)


CHILDREN = {
    "AIPos": {"A1": "1.25", "A2": "-90.5", "A3": "90", "A4": "-0.0001", "A5": ".5", "A6": "359.999999"},
    "MACur": {"A1": "1", "A2": "2", "A3": "3", "A4": "4", "A5": "5", "A6": "6"},
    "Delay": {"D": "17"},
    "IPOC": "00123456789",
    "Source1": "-1.5",
}


def render(order, gap, blank, quote, closed, root):
    parts = []
    for name in order:
        child = CHILDREN[name]
        if isinstance(child, str):
            parts.append(f"<{name}>{gap}{child}{gap}</{name}{blank}>")
        else:
            attributes = "".join(f"{gap or ' '}{a}{blank}={blank}{quote}{v}{quote}" for a, v in child.items())
            parts.append(f"<{name} {attributes}{blank}/>" if closed else f"<{name} {attributes}{blank}></{name}>")
    return (f"<Rob {root}={quote}KUKA{quote}>" + gap + gap.join(parts) + gap + "</Rob>").encode()


@given(
    order=st.permutations(list(CHILDREN)),
    gap=st.sampled_from(["", "\n", "\r\n", "  \t"]),
    blank=st.sampled_from(["", " "]),
    quote=st.sampled_from(['"', "'"]),
    closed=st.booleans(),
    root=st.sampled_from(["Type", "TYPE"]),
    plain_first=st.booleans(),
)
def test_any_order_and_spacing_means_the_same(order, gap, blank, quote, closed, root, plain_first):
    plain = render(list(CHILDREN), "", "", '"', True, "Type")
    telegram = render(order, gap, blank, quote, closed, root)
    parser = Parser(plain if plain_first else telegram)
    ipoc, row = parser.parse(telegram)
    assert ipoc == b"00123456789"
    assert axes(parser, "AIPos", row) == [1.25, -90.5, 90.0, -0.0001, 0.5, 359.999999]
    assert row[parser.slots("Delay", ("D",))[0]] == 17.0


@given(st.lists(st.floats(-400, 400), min_size=6, max_size=6), st.integers(0, 2**63), st.integers(1, 12))
def test_numbers_come_back_with_all_their_digits(values, ipoc, precision):
    first = Parser(KUKA_SIMULATOR)
    telegram = KUKA_SIMULATOR.replace(b"<IPOC>0<", b"<IPOC>%d<" % ipoc)
    for old, value in zip((b'A1="0.0"', b'A2="-90.0"', b'A3="90.0"', b'A4="0.5"', b'A5="1.5"', b'A6="2.5"'), values, strict=True):
        telegram = telegram.replace(old, b'%b="%.*f"' % (old[:2], precision, value))
    digits, row = first.parse(telegram)
    assert digits == b"%d" % ipoc
    assert axes(first, "AIPos", row) == [float(f"{v:.{precision}f}") for v in values]


@pytest.mark.parametrize(
    "damage",
    [
        lambda t: t[:-3],
        lambda t: t + b"<Rob/>",
        lambda t: t.replace(b"<IPOC>0</IPOC>", b""),
        lambda t: t.replace(b"<IPOC>0", b"<IPOC>x"),
        lambda t: t.replace(b"</Rob>", b"<IPOC>4</IPOC></Rob>"),
        lambda t: t.replace(b'A1="0.0"', b'A1="0.0'),
        lambda t: t.replace(b'A1="0.0"', b'A1="&lt;"'),
        lambda t: b'<!DOCTYPE Rob [<!ENTITY a "1">]>' + t,
        lambda t: b"",
        lambda t: b"<Sen" + t[4:],
        lambda t: t.replace(b"<Delay", b"<Deep><Delay").replace(b"<IPOC", b"</Deep><IPOC"),
        lambda t: t.replace(b"<Delay", b"<!-- x --><Delay"),
        lambda t: t.replace(b"<IPOC>", b"".join(b'<X%d a="1"/>' % i for i in range(300)) + b"<IPOC>"),
        lambda t: t.replace(b'A1="0.0"', b'A1="' + b"1" * 300 + b'"'),
    ],
)
def test_what_no_controller_sends_is_refused(damage):
    with pytest.raises(Malformed):
        Parser(damage(KUKA_SIMULATOR))
    with pytest.raises(Malformed):
        Parser(KUKA_SIMULATOR).parse(damage(KUKA_SIMULATOR))


@pytest.mark.parametrize("text", [b"nan", b"inf", b"1_0", b"1.2.3", b"", b"--1", b"0x1"])
def test_no_wrong_number_is_ever_made_of_text(text):
    telegram = KUKA_SIMULATOR.replace(b'A1="0.0"', b'A1="' + text + b'"')
    with pytest.raises(Malformed):
        Parser(KUKA_SIMULATOR).parse(telegram)
    assert "AIPos.A1" not in Parser(telegram).names


@given(st.binary(max_size=400))
def test_garbage_is_refused_and_never_hangs(data):
    with pytest.raises(Malformed):
        scan(data)


@given(st.integers(0, len(KUKA_SIMULATOR) - 1), st.integers(0, 255))
def test_a_flipped_byte_is_refused_or_changes_one_value(position, byte):
    damaged = KUKA_SIMULATOR[:position] + bytes([byte]) + KUKA_SIMULATOR[position + 1 :]
    parser = Parser(KUKA_SIMULATOR)
    try:
        row = parser.parse(damaged)[1]
    except Malformed:
        return
    changed = [a for a, b in itertools.zip_longest(row, parser.parse(KUKA_SIMULATOR)[1]) if a != b and a == a]  # NaN: an element is missing
    assert len(changed) <= 1


OTHERS = KUKA_SIMULATOR.replace(b"<Delay", b'<GearTorque A1="12.5" A2="1"/><Status>5</Status><Message>on</Message><Delay')


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b'A1="12.5"', b'A1="nan"'),
        (b'A1="12.5"', b'A1="1.#QNAN"'),
        (b'A1="12.5"', b'A1="-1.#IND00"'),
        (b"<Status>5<", b"<Status><"),
        (b"<Status>5<", b"<Status>ready<"),
        (b"<Status>5</Status>", b""),
        (b"<Status>5</Status>", b"<Status>5</Status><New>7</New>"),
        (b">on<", b">a &amp; b<"),
        (b">on<", b">" + b"x" * 3000 + b"<"),
        (b">on<", b">42<"),
        (b'D="0"', b'D=""'),
    ],
)
@pytest.mark.parametrize("at_once", [False, True])
def test_what_nobody_needs_may_change_in_kind_at_any_time(before, after, at_once):
    changed = OTHERS.replace(before, after)
    assert changed != OTHERS
    parser = Parser(changed if at_once else OTHERS)
    for telegram in (changed, OTHERS):
        ipoc, row = parser.parse(telegram)
        assert ipoc == b"0"
        assert axes(parser, "AIPos", row) == [0.0, -90.0, 90.0, 0.5, 1.5, 2.5]


@pytest.mark.parametrize(("before", "now"), [(2**32 - 4, 0), (2**31 - 4, -(2**31)), (-4, 0), (1000, 1004)])
def test_ipoc_begins_again(before, now):
    sequence = Sequence(before, 4, 75, Counts())
    assert sequence.take(now) == (NEXT, 1)
    assert sequence.count == before + 4


def test_a_signed_ipoc_is_given_back_digit_by_digit():
    telegram = KUKA_SIMULATOR.replace(b"<IPOC>0<", b"<IPOC>-2147483648<")
    assert Parser(telegram).parse(telegram)[0] == b"-2147483648"


def test_answer_bytes():
    composer = Composer("ImFree", "AK", "Stop")
    assert composer.compose((0.0, 0.01, -1.5, 0.0, 0.0, 12.3456789), b"00123") == (
        b'<Sen Type="ImFree"><Stop>0</Stop><AK A1="0.000000" A2="0.010000" A3="-1.500000" A4="0.000000" A5="0.000000" A6="12.345679"/>'
        b"<IPOC>00123</IPOC></Sen>"
    )
    assert composer.compose((0.0,) * 6, b"4208163634", stop=True).startswith(b'<Sen Type="ImFree"><Stop>1</Stop>')
    assert Composer("KROSHU", "AKorr", "").compose((0.0,) * 6, b"1") == (
        b'<Sen Type="KROSHU"><AKorr A1="0.000000" A2="0.000000" A3="0.000000" A4="0.000000" A5="0.000000" A6="0.000000"/><IPOC>1</IPOC></Sen>'
    )


def test_answer_bytes_with_outputs():
    composer = Composer("ImFree", "AK", "Stop", (12, 3))
    axes = b'<AK A1="0.000000" A2="0.000000" A3="0.000000" A4="0.000000" A5="0.000000" A6="0.000000"/>'
    off = b'<Sen Type="ImFree"><Stop>0</Stop>' + axes + b'<DiO o12="0" o3="0"/><IPOC>7</IPOC></Sen>'
    assert composer.compose((0.0,) * 6, b"7") == off
    assert composer.compose((0.0,) * 6, b"7", outputs=0b10) == off.replace(b'o3="0"', b'o3="1"')
    assert composer.compose((0.0,) * 6, b"7") == off


def test_names_that_would_break_the_answer_are_refused():
    for names in (('x" y="', "AK", "Stop"), ("ImFree", "A K", "Stop"), ("ImFree", "AK", "<Stop>")):
        with pytest.raises(ValueError, match="no name"):
            Composer(*names)
