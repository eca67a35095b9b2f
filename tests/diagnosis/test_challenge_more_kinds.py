"""What more kinds outside the catalogue that once were fresh do, each by itself."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from orchestrator.diagnosis.rig.challenge.rig_parameters import rig_parameters
from orchestrator.diagnosis.rig.challenge.software import (
    compensate,
    first_controller,
    first_satellite,
    move_satellite,
)
from tests.diagnosis.challenge_parts import (
    ENCODER,
    FORCE,
    TICK,
    answers,
    driven,
    force_at,
    lags,
    moved,
    pressed,
    pushed,
    rates,
    series_of,
    smooth,
)


def test_a_supply_sags_by_and_by_where_the_drive_asks_for_much():
    sag = {"sag": 0.4, "sag_time": 0.1}
    for speed in (5e-3, 2e-2):
        plain, more = lags(speed), lags(speed, **sag)
        assert more[20] < plain[20] + 0.3 * (more[-1] - plain[-1])
        asked = 470.0**2 * more[-1]  # [m/s2]
        assert more[-1] == pytest.approx(plain[-1] / (1.0 - 0.4 * np.tanh(asked / 15.0)), rel=0.02)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_soft_stop_holds_back_by_a_share_of_what_goes_beyond(side):
    plain, held = driven()[0][ENCODER], driven(stop=0.1, stop_at=4.5e-3)[0][ENCODER]
    off = side * (held - plain)
    beyond = side * plain - 4.5e-3
    slow = np.abs(rates(plain)) < 2e-3
    assert (far := (beyond > 2e-4) & slow).sum() > 10
    assert off[far] == pytest.approx(-0.1 * beyond[far], abs=6e-6)
    assert np.abs(off[np.abs(plain) < 3.8e-3]).max() < 2e-6


def test_a_rod_gets_shorter_at_both_ends_under_load():
    short = [(22, 1e-4)]
    assert force_at(4e-4, memory=short) == pytest.approx(force_at(3e-4))
    assert force_at(-1e-2 - 4e-4, memory=short) == pytest.approx(force_at(-1e-2 - 3e-4))

    def twice(now):
        return pressed(now % 0.25)

    plain, less = (moved(twice, 500, 0.0045, unscrew=size)[1] for size in (0.0, 3e-6))
    lost = (less - plain)[[int(np.argmin(plain[:250])), 250 + int(np.argmin(plain[250:]))]]
    carried = TICK * np.cumsum(np.abs(less))
    deepest = [int(np.argmin(plain[:250])), 250 + int(np.argmin(plain[250:]))]
    assert lost == pytest.approx(1e5 * 3e-6 * carried[deepest], rel=0.05)
    assert lost[1] > 2.0 * lost[0] > 0.2


def test_a_slide_floats_the_higher_the_faster_it_goes():
    lift = {"lift": 5e-5, "lift_rate": 5e-3, "lift_time": 5e-3, "c": 0.0}
    assert force_at(3e-4, memory=[(23, 4e-5)], **lift) == pytest.approx(-1e5 * 3.4e-4)
    assert force_at(-1e-2 - 3e-4, memory=[(23, 4e-5)], **lift) == pytest.approx(1e5 * 2.6e-4)
    still, floating = (
        moved(lambda now: 0.0045 + 0.01 * min(now, 0.08), 300, 0.0045, 0.01, **{**lift, "lift": size})
        for size in (0.0, 5e-5)
    )
    more = still[1] - floating[1]
    assert more[75] == pytest.approx(5.0 * (1.0 - np.exp(-2.0)), rel=0.02)
    assert more[-1] == pytest.approx(0.0, abs=1e-3)


def test_an_adaptive_filter_smooths_what_hardly_moves():
    plain, bias = driven()[0][FORCE], smooth()[0].values["bias"]
    read = driven(calm=0.6, calm_step=5.0)[0][FORCE]
    value, expected = 0.0, []
    for force in plain - bias:
        off = force - value
        value += off * (1.0 - 0.6 * np.exp(-abs(off) / 5.0))
        expected.append(value + bias)
    assert read == pytest.approx(np.array(expected), abs=1e-9)
    assert 1.0 < np.abs(read - plain).max() < 10.0


def test_an_element_swings_on_its_washer():
    ring = {"ring": 0.4, "ring_omega": 2.0 * np.pi * 50.0, "ring_xi": 0.05}
    plain = driven()[0][FORCE] - smooth()[0].values["bias"]
    off = driven(**ring)[0][FORCE] - driven()[0][FORCE]
    w, fine, at, speed, expected = ring["ring_omega"], 50, 0.0, 0.0, []
    for before, after in pairwise(plain):
        for i in range(fine):
            force = before + (after - before) * i / fine
            speed += TICK / fine * (w * w * (force - at) - 0.1 * w * speed)
            at += TICK / fine * speed
        expected.append(0.4 * (at - after))
    assert np.abs(off).max() > 1.0
    assert off[1:] == pytest.approx(np.array(expected), abs=0.1 * np.abs(off).max())


def test_a_sensor_is_read_too_early_by_chance():
    early = series_of({"sampling": 1e-3}).sampling
    assert 0.0 <= early.min() < 1e-5 and 9.9e-4 < early.max() < 1e-3
    assert not series_of({}).sampling.any()
    found, series = driven(sampling=1e-3)
    plain = driven()[0][FORCE]
    before = np.concatenate([plain[:1], plain[:-1]])
    expected = plain + series.sampling / TICK * (before - plain)
    assert found[FORCE] == pytest.approx(expected, abs=0.5)
    assert np.abs(found[FORCE] - plain).max() > 1.0


def test_a_foil_is_stretched_until_it_tears_and_then_gone():
    foil = {"foil": 10.0, "foil_at": 1e-3, "foil_stretch": 8e-4}
    off = [force_at(depth, **foil) for depth in (-1.1e-3, -6e-4, -2e-4)]
    assert off == pytest.approx([0.0, -10.0 * 0.5 * (0.4 + 0.6 * 0.25), -10.0])
    assert force_at(-6e-4, memory=[(20, 1.0)], **foil) == 0.0
    assert force_at(-1e-2 + 6e-4, **foil) == 0.0  # at the rear frame

    def twice(now):
        return 0.0035 + 0.0015 * np.sin(np.pi * min(now % 0.25, 0.2) / 0.2) ** 2

    force = moved(twice, 500, 0.0035, **foil)[1]
    assert force[:250].min() < -8.0
    plain = moved(twice, 500, 0.0035)[1]
    assert force[250:] == pytest.approx(plain[250:], abs=1e-9)


def test_a_paste_is_as_stiff_as_it_was_struck():
    thick = {"thick": 0.2, "c": 0.0}
    assert force_at(4e-4, memory=[(19, 0.02)], **thick) == pytest.approx(1.2 * force_at(4e-4, c=0.0))
    assert force_at(4e-4, memory=[(19, 0.005)], **thick) == pytest.approx(1.05 * force_at(4e-4, c=0.0))
    plain, stiff = (moved(pressed, 250, 0.0045, thick=size, c=0.0) for size in (0.0, 0.2))
    touching = plain[1] < -5.0
    begin = int(np.argmax(plain[1] < 0.0))
    struck = rates(plain[0])[begin]
    share = stiff[1][touching] / plain[1][touching] - 1.0
    assert share == pytest.approx(0.2 * struck / 0.02, rel=0.05) and np.ptp(share) < 1e-6


def test_a_tape_pulls_once_it_was_pressed_until_its_hooks_let_go():
    hook = {"hook": 4.0, "hook_reach": 2e-4}
    assert force_at(-2e-4, **hook) == 0.0
    held = [(21, 1.0)]
    pulls = [force_at(-depth, memory=held, **hook) for depth in (1e-4, 2e-4, 8e-4)]
    assert pulls == pytest.approx([2.0 * np.exp(0.5), 4.0, 16.0 * np.exp(-3.0)])
    assert force_at(3e-4, memory=held, **hook) == force_at(3e-4)

    def away(now):
        return 0.003 + 0.0028 * np.sin(np.pi * min(now % 0.25, 0.2) / 0.2) ** 2

    force = moved(away, 500, 0.003, **hook)[1]
    for contact in (force[:250], force[250:]):
        deepest = int(np.argmin(contact))
        assert contact[:deepest].max() == 0.0 and contact[deepest:].max() == pytest.approx(4.0, rel=0.02)
        assert contact[-1] == 0.0


def test_lost_commands_are_made_up_as_if_all_went_on():
    values = {"bridge": 0.012, "bridge_rate": 10.0}
    bridged = series_of(values).bridged
    assert 5 <= np.count_nonzero(np.diff(bridged.astype(int)) > 0) <= 40 and not series_of({}).bridged.any()
    found, series = driven(**values)
    desired, case = smooth()[1][0], smooth()[0]
    sent = np.append(desired[1:], 0.0)
    pace, off = desired[1] - desired[0], np.zeros(len(sent))
    for n in range(1, len(sent) - 1):
        if series.bridged[n]:
            off[n] = sent[n - 1] + off[n - 1] + pace - sent[n]
        elif not series.bridged[n - 1]:
            pace = sent[n] - sent[n - 1]
    seen = (found - driven()[0])[ENCODER]
    late = max(range(12), key=lambda ticks: float(seen[ticks:-1] @ off[: len(off) - 1 - ticks]))
    assert np.abs(off).max() > 1e-5 and case.values["tau"] / TICK - 1.0 < late < 8
    assert np.corrcoef(seen[late:-1], off[: len(off) - 1 - late])[0, 1] > 0.9


def test_a_command_that_hardly_differs_is_not_sent():
    found = driven(change=5e-5)[0][ENCODER]
    plain, desired = driven()[0][ENCODER], smooth()[1][0]
    sent, last = np.append(desired[1:], desired[-1]), desired[0]
    held = np.zeros(len(sent))
    for n, one in enumerate(sent):
        last = last if abs(one - last) < 5e-5 else one
        held[n] = last
    assert np.abs(held - sent).max() < 5e-5
    off = (found - plain)[100:-1]
    steady = np.array([np.ptp(held[i - 25 : i + 1]) == 0.0 for i in range(100, len(held) - 1)])
    assert steady.sum() > 3  # where it turns back, nothing is sent for long
    assert off[steady] == pytest.approx((held - plain)[100:-1][steady], abs=5e-6)
    assert np.abs(off).max() < 6e-5


def test_what_touches_the_port_thrusts_once_in_each_contact():
    p, state = rig_parameters({"seek": 3.0, "seek_force": 10.0, "seek_time": 0.05}), first_satellite(0.0)
    speeds = []
    forces = [-20.0] * 200 + [0.0] * 10 + [20.0] * 100 + [0.0] * 10 + [-20.0] * 20
    for tick, force in enumerate(forces):
        state[0], state[1] = 0.0, 0.0
        move_satellite(p, 100.0, tick * TICK, TICK, force, 0.0, state)
        speeds.append(100.0 * state[1] / TICK - force)
    assert speeds[:49] == pytest.approx([3.0] * 49) and speeds[51:320] == pytest.approx([0.0] * 269)
    assert speeds[320:] == pytest.approx([3.0] * 20)


def test_what_rubs_in_its_hinge_is_taken_along_but_for_hard_pushes():
    hinge = {"rubbed": 0.2, "rubbed_force": 1.0}
    assert pushed(4.0, **hinge) == pytest.approx(pushed(4.0))  # a fifth of it: 0.8 N
    assert pushed(20.0, **hinge) == pytest.approx(19.0 / 80.0 * TICK)
    p, state = rig_parameters(hinge), first_satellite(0.0)
    for tick in range(400):
        move_satellite(p, 100.0, tick * TICK, TICK, 20.0 if tick < 100 else 0.0, 0.0, state)
        assert 80.0 * state[1] + 20.0 * state[9] == pytest.approx(0.02 * min(tick + 1, 100))
    assert state[1] == pytest.approx(state[9]) == pytest.approx(0.02)


def test_a_contact_gives_back_less_once_most_of_it_is_back():
    p, plain = rig_parameters({"passive": 0.3, "passive_from": 0.25}), rig_parameters({})
    guarded, free = (first_controller(1e5, 50.0, 0.0, 0.0) for _ in range(2))
    shares, back = [], []
    stored = highest = 0.0
    for tick in range(400):
        turn = np.pi * (tick % 200) / 200.0
        force, rate = -60.0 * np.sin(turn), 0.02 * np.cos(turn)
        for one, state in ((p, guarded), (plain, free)):
            compensate(one, 1e5, 1.8e-3, TICK, force, 0.0, 0.0, rate, state)
        stored = stored - force * rate * TICK if abs(force) > 4.0 else 0.0
        highest = max(highest, stored) if abs(force) > 4.0 else 0.0
        back.append(stored < 0.25 * highest)
        shares.append(guarded[11] / free[11] if free[11] else 1.0)
    assert 20 < sum(back) < 120 and shares == pytest.approx(np.where(back, 0.7, 1.0))


def test_friction_that_is_not_there_is_compensated_in_contact():
    p, plain = rig_parameters({"helped": 2.0, "helped_rate": 2e-3}), rig_parameters({})
    for force, expected in ((30.0, 2.0), (-30.0, 2.0), (2.0, 0.0)):
        helped, without = (first_controller(1e5, 50.0, 0.0, 0.0) for _ in range(2))
        for tick in range(1, 40):
            for one, state in ((p, helped), (plain, without)):
                compensate(one, 1e5, 1.8e-3, TICK, force, 3e-3 * tick * TICK, 0.0, 0.0, state)
        assert helped[11] - without[11] == pytest.approx(expected * np.tanh(1.5), abs=1e-3)
    still = answers([20.0] * 5, helped=2.0, helped_rate=2e-3)
    assert still == pytest.approx(answers([20.0] * 5))
