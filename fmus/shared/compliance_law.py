"""Active compliance control along the contact normal, for numbers on a line and for vectors in space alike.

A law on a line or in space derives from ContactLaw and tells what a component along a direction and the way
into the frame are. Forces act on the rod; `outward` is the direction in which the rod goes deeper into the
frame, minus the source's e = F/|F|.
"""

from __future__ import annotations

import math
from typing import Any

from shared.compliance import Parameters, State
from shared.sage_husa import SageHusaFilter
from shared.sampling import GRID_TOLERANCE

# Work is force times distance: near the turning point no force could restore it.
MINIMUM_SPEED_RATIO = 0.3
# An estimate this far below the initial one is noise; contact points are found by dividing by it.
MINIMUM_STIFFNESS_RATIO = 0.01


class ContactLaw:
    """The controller's algorithm: one call of `sample` per sample period; all memory lies in `state`.

    What derives from it defines `nothing` (a force of zero), `_along` (component in a direction), `_size`,
    `_outward`, `_axis` (of the increments), `_lead`, `_new_frame`, `_enter` and `_put_out`.
    """

    nothing: Any = 0.0

    def __init__(self, parameters: Parameters, state: State) -> None:
        self.parameters = parameters
        self.state = state
        self.filter = SageHusaFilter(state, parameters.forgetting_factor)
        self.block_length = round(parameters.identification_period / parameters.sample_period)
        settling = parameters.settling_time / parameters.sample_period
        self.settling_samples = math.ceil(settling - GRID_TOLERANCE)
        # The output is held for a period, so on average it is applied half a period late.
        self.look_ahead = 0.5 * parameters.sample_period if parameters.hold_compensation else 0.0

    def sample(self, u: Any) -> Any:
        """Take one sample of the inputs; return the force on the satellite [N] until the next."""
        p, s = self.parameters, self.state
        # The satellite has moved on since the inputs left it; work is booked where it is now.
        u = u._replace(desired_position=u.desired_position + u.desired_velocity * p.transfer_delay)
        if s.samples == 0:
            self._start(u)
        s.samples += 1
        self._lead(u)
        self._track_contact(u)
        if s.contact_state:
            self._identify(u)
            active = self._compensate(u)
        else:
            active = self.nothing
        self._put_out(u, active)
        if s.contact_state:
            s.held_position, s.held_velocity = u.desired_position, u.desired_velocity
            s.contact_samples += 1
        return s.force

    def estimates(self) -> tuple[float, float]:
        """Stiffness [N/m] and damping [N.s/m]: the initial ones until the first sample."""
        if self.state.samples == 0:
            return self.parameters.initial_stiffness, self.parameters.initial_damping
        return self.state.stiffness, self.state.damping

    def _start(self, u: Any) -> None:
        p, s = self.parameters, self.state
        s.stiffness, s.damping = p.initial_stiffness, p.initial_damping
        s.p_kk, s.p_cc = p.stiffness_sigma**2, p.damping_sigma**2
        s.r = p.force_sigma**2
        s.previous_measured = u.measured_force

    def _track_contact(self, u: Any) -> None:
        """Contact begins and ends with the measured force; the lead's transients have no say in it."""
        p, s = self.parameters, self.state
        size = self._size(u.measured_force)
        if size > p.contact_threshold and self._new_frame(u.measured_force):
            self._enter(u)
            if s.updates:
                # Another frame or another spot may be stiffer; a filter grown certain would not notice.
                s.p_kk += (p.stiffness_spread * s.stiffness) ** 2
            s.contact_samples = s.block_samples = s.blocks = 0
            s.block_force = s.block_position = s.block_velocity = self.nothing
            s.onset_position, s.onset_velocity = u.desired_position, u.desired_velocity
            s.onset_path = s.energy_error = 0.0
            s.applied_work = s.sensed_work = s.stretch_work = s.stretch_rate_work = 0.0
        elif size < p.release_threshold:
            s.contact_state = 0

    def _identify(self, u: Any) -> None:
        """Collect settled samples of this contact; feed the filter with increments of their means.

        Means over an interval obey the same linear law as single samples, at a fraction of the noise.
        """
        p, s = self.parameters, self.state
        pushing = -self._along(s.compensated_force, self._outward())
        if s.contact_samples < self.settling_samples or pushing <= p.contact_threshold:
            return
        s.block_force = s.block_force + s.compensated_force
        s.block_position = s.block_position + u.position
        s.block_velocity = s.block_velocity + u.velocity
        s.block_samples += 1
        if s.block_samples < self.block_length:
            return
        force, position, velocity = (
            total / self.block_length for total in (s.block_force, s.block_position, s.block_velocity)
        )
        if s.blocks == 0:
            s.anchor_force, s.anchor_position, s.anchor_velocity = force, position, velocity
        else:
            axis = self._axis()
            self.filter.update(
                self._along(force - s.previous_force, axis),
                self._along(position - s.previous_position, axis),
                self._along(velocity - s.previous_velocity, axis),
            )
        s.previous_force, s.previous_position, s.previous_velocity = force, position, velocity
        s.blocks += 1
        s.block_samples = 0
        s.block_force = s.block_position = s.block_velocity = self.nothing

    def _ahead(self, u: Any) -> Any:
        """Desired position in the middle of the period over which the output will be held."""
        return u.desired_position + u.desired_velocity * self.look_ahead

    def _compensate(self, u: Any) -> Any:
        """Eqs. (27) to (29) during contact, plus what restores the work missed at onset; never a pull."""
        p, s = self.parameters, self.state
        stiffness = max(s.stiffness, MINIMUM_STIFFNESS_RATIO * p.initial_stiffness)
        damping = max(s.damping, 0.0)
        self._book_work(u)
        outward = self._outward()
        stretch = self._along(self._ahead(u) - u.position, outward)
        stretch_rate = self._along(u.desired_velocity - u.velocity, outward)
        force = s.compensated_force - outward * (stiffness * stretch) - outward * (damping * stretch_rate)
        along = self._along(force, outward)
        pushing = along < 0.0
        # Where the law would pull, the desired rod has left the frame, though the real one has not yet.
        s.held_sensed, s.held_stretch, s.held_stretch_rate = (
            (s.compensated_force, outward * stretch, outward * stretch_rate)
            if pushing
            else (self.nothing, self.nothing, self.nothing)
        )
        if not pushing:
            return self.nothing
        if s.blocks == 0:
            return force
        s.energy_error = s.applied_work - self._law_work(stiffness, damping)
        speed = self._along(u.desired_velocity, outward)
        fast_enough = abs(speed) > MINIMUM_SPEED_RATIO * abs(self._along(s.onset_velocity, outward))
        if p.switching_compensation and fast_enough:
            restoring = -s.energy_error / (speed * p.restoration_time)
            # At most as much again as the contact law asks for, so that the force stays a push.
            force = force + outward * min(max(restoring, -abs(along)), abs(along))
        return force

    def _book_work(self, u: Any) -> None:
        """Book the work along the normal over the period that ends now; exact, since the output was held."""
        s = self.state
        if s.contact_samples == 0:
            s.settled_position = u.desired_position
            return
        outward = self._outward()
        distance = self._along(u.desired_position - s.held_position, outward)
        s.applied_work += self._along(s.force, outward) * distance
        if s.contact_samples <= self.settling_samples:
            s.onset_path += 0.5 * self._along(s.held_velocity + u.desired_velocity, outward) * distance
            s.settled_position = u.desired_position
        else:
            s.sensed_work += self._along(s.held_sensed, outward) * distance
            s.stretch_work += self._along(s.held_stretch, outward) * distance
            s.stretch_rate_work += self._along(s.held_stretch_rate, outward) * distance

    def _law_work(self, stiffness: float, damping: float) -> float:
        """Work [J] that the contact law, with the present estimates, would have done on the satellite.

        From the contact point to where the force had settled it is the spring's and the damper's, of the
        desired motion; from there on that of Eq. (29). The contact point follows from the first interval.
        """
        s, outward = self.state, self._outward()
        anchor_force, anchor_position, anchor_velocity = (
            self._along(value, outward) for value in (s.anchor_force, s.anchor_position, s.anchor_velocity)
        )
        contact_point = anchor_position + (anchor_force + damping * anchor_velocity) / stiffness
        depth = max(0.0, self._along(s.settled_position, outward) - contact_point)
        undetected = max(0.0, self._along(s.onset_position, outward) - contact_point)
        loss = damping * (abs(self._along(s.onset_velocity, outward)) * undetected + s.onset_path)
        return (
            s.sensed_work
            - 0.5 * stiffness * depth**2
            - loss
            - stiffness * s.stretch_work
            - damping * s.stretch_rate_work
        )
