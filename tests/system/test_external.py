"""Programs reached over UDP: on loopback, with what gets lost on the way put there by the tests."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction

import numpy as np
import pytest
from assembled import assemble
from doubles import mass, spring
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.base.errors import ConfigError, FmuError, StepError
from orchestrator.config import ExternalModel, load_config
from orchestrator.fmi import Array
from orchestrator.master.jacobi import Jacobi
from orchestrator.simulation.grid import Grid
from orchestrator.simulation.loop import simulate
from orchestrator.simulation.run import run
from orchestrator.system.assembly import Part
from orchestrator.system.external import ExternalFmu
from orchestrator.system.external.datagram import Datagram, Flag, pack, unpack
from orchestrator.system.external.link import Link, LinkError
from orchestrator.system.system import System

STEPS = 200
STEP = Fraction(1, 1000)


def free_ports(count: int) -> list[int]:
    made = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for one in made:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in made]
    for one in made:
        one.close()
    return ports


def external(listen: int, peer: int, **changes) -> ExternalModel:
    given = {
        "listen": f"127.0.0.1:{listen}",
        "peer": f"127.0.0.1:{peer}",
        "exchange": "lockstep",
        "timeout": "10 s",
        **changes,
    }
    return ExternalModel.model_validate(given)


def recorded(system: System, names: list[str]) -> Array:
    from orchestrator.system.signal_vector import Layout
    from orchestrator.system.system import Port

    layout = Layout.of(system)
    places = [layout.index[Port(*name.split("."))] for name in names]
    rows: list[Array] = []
    grid = Grid(Fraction(0), STEP, STEPS)
    simulate(system, Jacobi(), grid, [lambda point, signals: rows.append(signals.values[places])])
    return np.array(rows)


def two_sides(station: int, to_station: int, rig: int, to_rig: int) -> tuple[Array, Array]:
    """A mass here, its spring there. Returns: positions and forces, as each side recorded them."""
    here = external(station, to_rig, send={"position": "mm"}, receive={"force": "N"})
    there = external(rig, to_station, send={"force": "N"}, receive={"position": "mm"})
    first = assemble(
        [
            Part("mass", mass(2.0), {"velocity": "1 m/s", "position": "0 m"}),
            Part("rig", ExternalFmu("rig", here)),
        ],
        ["mass.position -> rig.position", "rig.force -> mass.force"],
    )
    second = assemble(
        [Part("spring", spring(500.0)), Part("station", ExternalFmu("station", there))],
        ["station.position -> spring.position", "spring.force -> station.force"],
    )
    found: dict[str, Array] = {}
    other = threading.Thread(target=lambda: found.update(force=recorded(second, ["spring.force"])))
    other.start()
    found["position"] = recorded(first, ["mass.position"])
    other.join(20)
    return found["position"], found["force"]


def in_one_process() -> tuple[Array, Array]:
    system = assemble(
        [Part("mass", mass(2.0), {"velocity": "1 m/s", "position": "0 m"}), Part("spring", spring(500.0))],
        [
            {"from": "mass.position", "to": "spring.position", "through": [{"delay": "1 ms"}]},
            {"from": "spring.force", "to": "mass.force", "through": [{"delay": "1 ms"}]},
        ],
        step_size=float(STEP),
    )
    both = recorded(system, ["mass.position", "spring.force"])
    return both[:, :1], both[:, 1:]


def test_lockstep_is_one_step_of_delay_each_way():
    a, b = free_ports(2)
    position, force = two_sides(a, a, b, b)
    expected_position, expected_force = in_one_process()
    assert np.ptp(expected_force) > 10.0  # the spring does something
    assert position == pytest.approx(expected_position, rel=1e-12, abs=1e-15)
    assert force == pytest.approx(expected_force, rel=1e-12, abs=1e-12)


@contextmanager
def relay(listen: int, to: int, lose: Callable[[int], bool]) -> Iterator[None]:
    """Pass datagrams on, less those that are lost, by their number."""
    own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    own.bind(("127.0.0.1", listen))
    own.settimeout(0.1)
    over = threading.Event()

    def work() -> None:
        number = 0
        while not over.is_set():
            try:
                data, _ = own.recvfrom(65535)
            except TimeoutError:
                continue
            number += 1
            if not lose(number):
                own.sendto(data, ("127.0.0.1", to))

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        own.close()


def test_lockstep_sends_again_what_was_lost():
    a, b, to_a, to_b = free_ports(4)
    with relay(to_a, a, lambda n: n % 31 == 0), relay(to_b, b, lambda n: n % 37 == 5):
        position, _ = two_sides(a, to_a, b, to_b)
    assert position == pytest.approx(in_one_process()[0], rel=1e-12, abs=1e-15)


@given(
    st.integers(0, 2**64 - 1),
    st.integers(0, 2**64 - 1),
    st.floats(allow_nan=False),
    st.lists(st.floats(allow_nan=False), max_size=20),
)
def test_datagrams_come_out_as_they_went_in(session, sequence, time, values):
    one = Datagram(Flag.NONE, session, sequence, time, 5, 7, np.array(values))
    back = unpack(pack(one))
    assert back is not None
    assert (back.session, back.sequence, back.time, back.stamp, back.echo) == (session, sequence, time, 5, 7)
    assert np.array_equal(back.values, values)


@given(st.binary(max_size=200))
def test_what_is_no_datagram_is_none(data):
    assert unpack(data) is None or data.startswith(b"OCU1")
    assert unpack(b"OCU1" + data) is None or len(data) >= 44


class Peer:
    """The other side of a link, by hand."""

    def __init__(self, link_port: int, port: int) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", port))
        self.link_port = link_port

    def say(self, sequence: int, *values: float, flag: Flag = Flag.NONE, session: int = 77) -> None:
        data = pack(Datagram(flag, session, sequence, 0.0, 1, 0, np.array(values)))
        self.socket.sendto(data, ("127.0.0.1", self.link_port))


@pytest.fixture
def pair():
    a, b = free_ports(2)
    link, peer = Link(("127.0.0.1", a), ("127.0.0.1", b), 1), Peer(a, b)
    peer.say(0, flag=Flag.HELLO)
    link.connect(5.0)
    yield link, peer
    link.close()
    peer.socket.close()


def test_the_latest_value_is_held_and_losses_are_counted(pair):
    link, peer = pair
    assert link.latest(10.0) is None
    peer.say(1, 1.0)
    assert link.of_step(1, 5.0) == [1.0]
    for sequence in (2, 5, 4, 5):  # 3 is lost, 4 comes late, 5 twice
        peer.say(sequence, float(sequence))
    peer.say(9, 9.0, session=78)  # of an earlier run
    peer.socket.sendto(b"something else", ("127.0.0.1", peer.link_port))
    peer.say(6, 6.0)
    link.of_step(6, 5.0)
    assert link.latest(10.0) == [6.0]
    assert link.latest(10.0) == [6.0]
    reported = link.statistics()
    counts = {key: reported[key] for key in ("received", "lost", "reordered", "duplicates", "foreign")}
    assert counts == {"received": 5, "lost": 1, "reordered": 1, "duplicates": 1, "foreign": 2}
    assert reported["age"]["count"] == 2


def test_a_silent_peer_is_reported(pair):
    link, peer = pair
    peer.say(1, 1.0)
    assert link.of_step(1, 5.0) == [1.0]
    with pytest.raises(LinkError, match=r"nothing from 127.0.0.1:\d+ for .* s \(last: its step 1\)"):
        link.of_step(2, 0.06)
    with pytest.raises(LinkError, match="nothing from"):
        link.latest(0.01)


class Stranger:
    """In place of a link's socket, and of its clock: somebody who sends every 10 ms, and never the peer."""

    def __init__(self, link: Link, monkeypatch: pytest.MonkeyPatch) -> None:
        self.own, self.sent = link._socket, 0
        self.now = self.begin = link._heard
        monkeypatch.setattr(link, "_socket", self)
        monkeypatch.setattr("orchestrator.system.external.link.perf_counter_ns", lambda: self.now)

    def settimeout(self, seconds: float) -> None: ...

    def close(self) -> None:
        self.own.close()

    def sendto(self, data: bytes, address: object) -> None:
        self.sent += 1

    def recvfrom(self, size: int) -> tuple[bytes, None]:
        self.now += 10_000_000
        assert self.now - self.begin < 10_000_000_000, "the wait has no end"
        return b"telemetry", None


def test_a_stranger_who_goes_on_sending_puts_no_deadline_off(pair, monkeypatch):
    link, _ = pair
    one = Link(("127.0.0.1", 0), ("127.0.0.1", 9), 1)
    stranger = Stranger(one, monkeypatch)
    with pytest.raises(LinkError, match="within 1 s; 101 datagrams came that are not its"):
        one.connect(1.0)
    assert stranger.sent == 21  # greetings, each 50 ms
    one.close()
    link.send(1, 0.0, np.array([1.0]))
    stranger = Stranger(link, monkeypatch)
    with pytest.raises(LinkError, match=r"for 1.01 s \(a greeting before\); 101 datagrams came"):
        link.of_step(1, 1.0)
    assert stranger.sent == 20  # what the peer may have missed
    with pytest.raises(LinkError, match="nothing from"):
        link.latest(0.5)


def test_a_peer_that_ended_is_reported(pair):
    link, peer = pair
    peer.say(0, flag=Flag.END)
    with pytest.raises(LinkError, match="ended its run before its step 1"):
        link.of_step(1, 5.0)


def test_another_number_of_values_is_reported(pair):
    link, peer = pair
    peer.say(1, 1.0, 2.0)
    with pytest.raises(LinkError, match="sends 2 values, 1 are expected: its `send` and"):
        link.of_step(1, 5.0)


def test_a_peer_that_never_comes_ends_the_run_before_the_first_step():
    a, b = free_ports(2)
    here = external(a, b, send={"position": "m"}, connect="60 ms")
    system = assemble(
        [
            Part("mass", mass(), {"force": "1 N", "velocity": "1 m/s", "position": "0 m"}),
            Part("rig", ExternalFmu("rig", here)),
        ],
        ["mass.position -> rig.position"],
    )
    with pytest.raises(StepError, match=f"Start the other side, its peer being 127.0.0.1:{a}") as error:
        simulate(system, Jacobi(), Grid(Fraction(0), STEP, 3))
    assert error.value.instance == "rig"


def test_an_address_in_use_is_reported():
    a, b = free_ports(2)
    model = external(a, b, send={"position": "m"})
    first = ExternalFmu("rig", model).instantiate("rig")
    try:
        with pytest.raises(FmuError, match=rf"external.rig: cannot use 127.0.0.1:{a} towards 127.0.0.1:{b}"):
            ExternalFmu("rig", model).instantiate("rig")
    finally:
        first.free()


CONFIG = {
    "run": {"master": "jacobi", "step_size": "1 ms", "stop_time": "10 ms"},
    "instances": {"satellite": {"fmu": "SatelliteDynamics", "start": {"mass": "1 kg", "force": "0 N"}}},
    "connections": ["satellite.position -> rig.command"],
}


def with_external(**changes) -> dict:
    rig = {"listen": "127.0.0.1:47010", "peer": "127.0.0.1:47011", "exchange": "latest", **changes}
    return CONFIG | {"external": {"rig": rig}}


def test_units_are_checked_at_the_link():
    from orchestrator.simulation.run import prepare

    system = prepare(with_external(send={"command": "mm"})).system
    (connection,) = system.connections
    assert connection.gain == 1000.0
    with pytest.raises(ConfigError, match=r"cannot connect satellite.position \[m\] to rig.command \[N\]"):
        prepare(with_external(send={"command": "N"}))


def test_all_that_is_wrong_with_a_link_is_reported_at_once():
    wrong = with_external(
        listen="localhost", peer="127.0.0.1:99999", send={"command": "parsec"}, timeout="3", unknown=1
    )
    with pytest.raises(ConfigError) as error:
        load_config(wrong)
    text = str(error.value)
    for part in (
        "external.rig.listen: 'localhost' is no address; written as 127.0.0.1:47010",
        "external.rig.peer: '127.0.0.1:99999' is no address",
        "parsec",
        "external.rig.timeout: '3' has no unit",
        "unknown key 'unknown'",
    ):
        assert part in text, text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "nothing is sent and nothing received"),
        ({"send": {"a": "m"}, "receive": {"a": "m"}}, "'a' is sent and received"),
        ({"send": {"a": "m"}, "peer": "127.0.0.1:47010"}, "listen and peer are both"),
        ({"receive": {"a": {"unit": "m", "start": "3 N"}}}, "cannot be converted"),
        ({"receive": {"a": {"unit": "m", "start": 3}}}, "has no unit"),
    ],
)
def test_links_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        load_config(with_external(**changes))


def test_station_and_rig_meet_on_loopback(tmp_path):
    a, b = free_ports(2)
    common = ["run.stop_time=0.6 s", "run.realtime=null"]
    here = [*common, f"external.rig.listen=127.0.0.1:{a}", f"external.rig.peer=127.0.0.1:{b}"]
    there = [*common, f"external.station.listen=127.0.0.1:{b}", f"external.station.peer=127.0.0.1:{a}"]
    here.append("external.rig.exchange=lockstep")
    there += ["external.station.exchange=lockstep", "run.master=jacobi"]
    made = {}

    def rig() -> None:
        made["rig"] = run("docking-1d-rig", overrides=there, halving=True)

    thread = threading.Thread(target=rig)
    thread.start()
    made["station"] = run("docking-1d-station", overrides=here, halving=True, out=tmp_path)
    thread.join(20)
    link = made["station"].summary["run"]["external"]["rig"]
    assert (link["sent"], link["received"], link["lost"]) == (600, 600, 0)
    assert link["round_trip"]["count"] > 0
    assert "another program" in made["station"].summary["numerics"]["error"]["message"]
    # What the rig did arrives a step later, held over Jacobi's step.
    there_position = made["rig"].results["robot.position"]
    here_position = made["station"].results["rig.position"]
    assert np.array_equal(here_position[2:], there_position[1:-1])
    assert np.abs(there_position).max() > 5e-3  # it came into contact
    assert np.abs(made["station"].results["rig.force"]).max() > 50.0
