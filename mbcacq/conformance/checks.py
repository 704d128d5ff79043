"""The checks: what every driver owes the tool, whatever it drives. Each takes a bench and a fresh stand, and raises AssertionError."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.events import Event, FactChanged, Message
from mbcacq.acquisition.fact_watch import FactWatch
from mbcacq.conformance.bounded import bounded, demand, eventually, outcome
from mbcacq.conformance.driver_bench import DriverBench, Stand
from mbcacq.conformance.steps import Skip, comes_back, fault, need_proxies, rests, segments, works, works_anew
from mbcacq.devices import Aborted, ConfigError, ConnectError, Fact, IdentityError

Check = Callable[[DriverBench, Stand], None]


def describes_itself_unconnected(bench: DriverBench, stand: Stand) -> None:
    driver = stand.make()
    demand(isinstance(driver, bench.protocol), f"it is no {bench.protocol.__name__}: a method is missing")
    about = driver.describe()
    demand(about.kind == bench.kind, f"describe() says kind '{about.kind}'")
    names = [field.name for field in about.fields]
    demand(names, "describe() names no field")
    demand(len(set(names)) == len(names), "describe() names a field twice")
    demand(all(proxy.connections == 0 for proxy in stand.proxies.values()), "it opened a connection before connect()")
    outcome("close", driver.close, bench.limit_s)


def refuses_an_unknown_option(bench: DriverBench, stand: Stand) -> None:
    error = outcome("construction", lambda: stand.make(no_such_option=1), bench.limit_s)
    demand(isinstance(error, ConfigError), f"an unknown option gives {error!r} instead of a ConfigError")
    demand("no_such_option" in str(error), f"the error does not name the option: {error}")


def connects_and_works(bench: DriverBench, stand: Stand) -> None:
    works(bench, stand, stand.make(), times=2)


def refuses_the_wrong_device(bench: DriverBench, stand: Stand) -> None:
    if stand.wrong is None:
        raise Skip("the bench gives no wrong device")
    driver = stand.wrong()
    error = outcome("connect", driver.connect, bench.limit_s)
    demand(isinstance(error, IdentityError), f"connecting to another device gives {error!r} instead of an IdentityError")
    outcome("close", driver.close, bench.limit_s)
    works_anew(bench, stand)


def names_an_absent_device(bench: DriverBench, stand: Stand) -> None:
    need_proxies(stand)
    for proxy in stand.proxies.values():
        proxy.refuse(True)
    driver = stand.make(**stand.short_limits)
    error = outcome("connect", driver.connect, bench.limit_s)
    demand(isinstance(error, ConnectError), f"connecting to nothing gives {error!r} instead of a ConnectError")
    bounded("close", driver.close, bench.limit_s)
    for proxy in stand.proxies.values():
        proxy.refuse(False)
    works_anew(bench, stand)


def refuses_to_work_unconnected(bench: DriverBench, stand: Stand) -> None:
    driver = stand.make()
    error = outcome("use", lambda: stand.use(driver), bench.limit_s)
    demand(error is not None, "it works without a connection")
    outcome("close", driver.close, bench.limit_s)


def silence_is_an_error_in_time(bench: DriverBench, stand: Stand) -> None:
    fault(bench, stand, "drop", must_fail=True)


def garbage_is_survived(bench: DriverBench, stand: Stand) -> None:
    fault(bench, stand, "garbage")


def half_a_message_is_survived(bench: DriverBench, stand: Stand) -> None:
    fault(bench, stand, "truncate")


def an_end_in_mid_frame_is_survived(bench: DriverBench, stand: Stand) -> None:
    fault(bench, stand, "close")


def two_messages_in_one_segment_are_two(bench: DriverBench, stand: Stand) -> None:
    segments(bench, stand, "join")


def a_message_byte_by_byte_is_one(bench: DriverBench, stand: Stand) -> None:
    segments(bench, stand, "split")


def connects_again(bench: DriverBench, stand: Stand) -> None:
    driver = stand.make()
    for _ in range(2):
        works(bench, stand, driver)
    bounded("connect", driver.connect, bench.limit_s)
    for proxy in stand.proxies.values():
        proxy.cut()
    outcome("use after the connection was cut", lambda: stand.use(driver), bench.limit_s)
    bounded("close", driver.close, bench.limit_s)
    comes_back(bench, stand)
    works(bench, stand, driver)


def stop_and_close_are_always_allowed(bench: DriverBench, stand: Stand) -> None:
    driver = stand.make()
    for step in (driver.stop, driver.stop, driver.close, driver.close):
        bounded("stop or close before connect", step, bench.limit_s)
    with driver:
        bounded("use", lambda: stand.use(driver), bench.limit_s)
        for _ in range(2):
            bounded("stop", driver.stop, bench.limit_s)
    for step in (driver.stop, driver.close, driver.stop):
        bounded("stop or close after close", step, bench.limit_s)
    rests(bench, stand)
    works_anew(bench, stand)


def stop_ends_what_is_under_way(bench: DriverBench, stand: Stand) -> None:
    begin, at_rest = stand.begin, stand.at_rest
    if begin is None:
        raise Skip("nothing of this device takes long")
    driver = stand.make()
    bounded("connect", driver.connect, bench.limit_s)
    ended = threading.Event()
    raised: list[BaseException] = []

    def long() -> None:
        try:
            begin(driver)
        except BaseException as error:
            raised.append(error)
        finally:
            ended.set()

    threading.Thread(target=long, name="under-way", daemon=True).start()
    if at_rest is not None:
        eventually(lambda: not at_rest() or bool(raised), bench.limit_s, "the device never began")
    else:
        ended.wait(0.1)
    for _ in range(2):
        bounded("stop", driver.stop, bench.limit_s)
    demand(ended.wait(bench.limit_s), f"what was under way did not end within {bench.limit_s:g} s of stop()")
    wrong = [error for error in raised if not isinstance(error, Aborted)]
    demand(not wrong, f"a stopped operation raised {wrong!r} instead of Aborted")
    rests(bench, stand)
    bounded("close", driver.close, bench.limit_s)
    works_anew(bench, stand)


def a_changed_fact_is_seen(bench: DriverBench, stand: Stand) -> None:
    driver = stand.make()
    facts = getattr(driver, "facts", tuple)
    demand(facts() == (), "facts() names some before connect()")
    bounded("connect", driver.connect, bench.limit_s)
    bounded("use", lambda: stand.use(driver), bench.limit_s)
    first = {fact.name: fact for fact in facts()}
    demand(first.keys() == stand.facts.keys(), f"the driver declares {sorted(first)}, the bench changes {sorted(stand.facts)}")
    for name in stand.facts:
        _changes(bench, stand, driver, first[name])
    bounded("close", driver.close, bench.limit_s)
    if not first:
        raise Skip("this device reports no facts")


def _changes(bench: DriverBench, stand: Stand, driver: Any, first: Fact) -> None:
    """One fact is changed at the device, in the middle of a pose of one run, and between two poses of another."""
    seen: list[Event] = []
    run, other = (FactWatch({bench.kind: driver}, EventBus([seen.append])) for _ in range(2))
    for watch in (run, other):
        watch.look()
    run.mark()
    stand.facts[first.name]()
    if bench.kind != "positioner":  # some report with each exposure, motion or reading
        bounded("use", lambda: stand.use(driver), bench.limit_s)
    eventually(lambda: bool(run.look() or seen), bench.limit_s, f"'{first.name}' was changed, and facts() is {driver.facts()}")
    before, now = first.text, run.values[f"{bench.kind} {first.name}"]
    texts = [event.text for event in seen if isinstance(event, Message)]
    demand(any(before in text and now in text for text in texts), f"no text names '{before}' and '{now}' of '{first.name}': {texts}")
    recorded = [(event.name, event.before, event.now) for event in seen if isinstance(event, FactChanged)]
    demand((first.name, before, now) in recorded, f"the change of '{first.name}' to '{now}' is not in the recording: {recorded}")
    strange = [run.since_mark()]
    for watch in (run, other):
        watch.mark()
        strange.append(watch.since_mark())
    wrong = [text for text in strange if (before in text and now in text) != first.critical]
    demand(not wrong, f"a pose under another '{first.name}' is not kept apart: {wrong}")


def closes_after_an_exception(bench: DriverBench, stand: Stand) -> None:
    driver = stand.make()

    def broken() -> None:
        with driver:
            raise KeyError("a fault of the program around it")

    try:
        bounded("with", broken, bench.limit_s)
    except KeyError:
        pass
    else:
        raise AssertionError("leaving the context swallowed an exception")
    rests(bench, stand)
    works_anew(bench, stand)


def an_output_that_is_on_goes_off(bench: DriverBench, stand: Stand) -> None:
    if stand.output is None:
        raise Skip("it switches no outputs")
    number, is_on = stand.output
    driver = stand.make(digital_outputs=[number])
    bounded("connect", driver.connect, bench.limit_s)
    for value in (True, False, True):
        bounded("set_output", lambda value=value: driver.set_output(number, value), bench.limit_s)
        eventually(lambda value=value: is_on() == value, bench.limit_s, f"set_output({number}, {value}) returned, and nothing was switched")
    bounded("stop", driver.stop, bench.limit_s)
    eventually(lambda: not is_on(), bench.limit_s, f"output {number} was still on after stop()")
    error = outcome("set_output", lambda: driver.set_output(number + 1, True), bench.limit_s)
    demand(isinstance(error, ConfigError), f"an output that the plan does not name gives {error!r} instead of a ConfigError")
    bounded("set_output", lambda: driver.set_output(number, True), bench.limit_s)
    bounded("close", driver.close, bench.limit_s)
    eventually(lambda: not is_on(), bench.limit_s, f"output {number} was still on after close()")


CHECKS: tuple[Check, ...] = (
    describes_itself_unconnected,
    refuses_an_unknown_option,
    connects_and_works,
    refuses_the_wrong_device,
    names_an_absent_device,
    refuses_to_work_unconnected,
    silence_is_an_error_in_time,
    garbage_is_survived,
    half_a_message_is_survived,
    an_end_in_mid_frame_is_survived,
    two_messages_in_one_segment_are_two,
    a_message_byte_by_byte_is_one,
    connects_again,
    stop_and_close_are_always_allowed,
    stop_ends_what_is_under_way,
    closes_after_an_exception,
    an_output_that_is_on_goes_off,
    a_changed_fact_is_seen,
)
