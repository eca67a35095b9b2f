"""Contacts found in constructed signals."""

import numpy as np

from orchestrator.docking.contacts import find_contacts


def signals(*stretches):
    """Rows of (count, velocity, force), at 1 ms."""
    velocity = np.concatenate([np.full(count, value) for count, value, _ in stretches])
    force = np.concatenate([np.full(count, value) for count, _, value in stretches])
    return np.arange(len(velocity)) * 1e-3, velocity.astype(float), force.astype(float)


def test_two_contacts_and_an_open_third():
    found = find_contacts(
        *signals((10, 1, 0), (5, 0, -7), (10, -1.2, 0), (5, 0, 9), (10, 1.5, 0), (3, 0.5, -2))
    )
    assert [(c.side, c.peak_force, c.velocity_before, c.velocity_after) for c in found] == [
        ("front", 7.0, 1.0, -1.2),
        ("rear", 9.0, -1.2, 1.5),
    ]
    assert [c.restitution for c in found] == [1.2, 1.25]
    assert (found[0].start_time, found[0].end_time) == (0.010, 0.014)


def test_last_contact_counts_once_the_velocity_has_settled():
    assert len(find_contacts(*signals((10, 1, 0), (5, 0, -7), (3, -1, 0)))) == 0
    assert len(find_contacts(*signals((10, 1, 0), (5, 0, -7), (12, -1, 0)))) == 1


def test_a_bounce_at_the_same_frame_belongs_to_one_contact():
    found = find_contacts(*signals((5, 1, 0), (3, 0, -7), (1, 0, 0), (2, -0.5, -8), (20, -1, 0)))
    assert len(found) == 1
    assert (found[0].peak_force, found[0].first, found[0].last) == (8.0, 5, 10)


def test_free_velocity_is_read_where_no_controller_pushes():
    """Neither the remainder of the last contact nor the push of one that predicts the next belongs to it."""
    found = find_contacts(
        *signals(
            (10, 1, 0),
            (2, 0.9, 0),
            (5, 0, -7),
            (2, -0.8, 0),
            (10, -1, 0),
            (2, -0.9, 0),
            (5, 0, 9),
            (20, 1, 0),
        )
    )
    assert [(c.velocity_before, c.velocity_after) for c in found] == [(1.0, -1.0), (-1.0, 1.0)]


def test_no_contact():
    assert find_contacts(*signals((10, 1, 0))) == []
