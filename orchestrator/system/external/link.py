"""A UDP link to a peer: sends values, takes the latest or waits for those of a step, and counts losses."""

from __future__ import annotations

import secrets
import socket
from collections import OrderedDict
from time import perf_counter_ns
from typing import Any

import numpy as np

from ...base.histogram import Histogram
from ...fmi import Array
from .datagram import Datagram, Flag, pack, unpack

# While a peer does not answer, what it may have missed is sent again this often [s].
_AGAIN = 0.05
_AGAIN_NS = int(_AGAIN * 1e9)
# Number of stored sequence numbers, to detect duplicates, and of datagrams that can be requested again.
_REMEMBERED, _KEPT = 1024, 3
_NOTHING = np.zeros(0)


class LinkError(Exception):
    """A link that does not work; the message says how."""


class Link:
    """One side of a link.

    Args:
        listen, peer: addresses, host and port.
        expected: number of values that the peer sends.
    Raises: OSError if the address cannot be listened on.
    """

    def __init__(self, listen: tuple[str, int], peer: tuple[str, int], expected: int) -> None:
        family, _, _, _, own = socket.getaddrinfo(*listen, type=socket.SOCK_DGRAM)[0]
        self._peer = socket.getaddrinfo(*peer, family=family, type=socket.SOCK_DGRAM)[0][4]
        self._expected = expected
        self._session = secrets.randbits(63)
        self._theirs: int | None = None
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind(own)
        except OSError:
            self._socket.close()
            raise
        self._sent: OrderedDict[int, bytes] = OrderedDict()
        self._seen: OrderedDict[int, Array] = OrderedDict()
        self._latest: Datagram | None = None
        self._echo = 0
        self._heard = perf_counter_ns()
        self._ended = False
        self._counts = dict.fromkeys(
            ("sent", "sent_again", "received", "duplicates", "reordered", "foreign"), 0
        )
        self._round_trip, self._age = Histogram(), Histogram()

    def close(self) -> None:
        """Let go of the address; safe to call twice."""
        self._socket.close()

    def connect(self, seconds: float) -> None:
        """Wait for the peer, and confirm that it was received. Raises: LinkError."""
        begin = perf_counter_ns()
        again = begin
        while self._theirs is None:
            if perf_counter_ns() >= again:
                self._say(Flag.HELLO)
                again = perf_counter_ns() + _AGAIN_NS
            # Others may send without an end: what they send puts nothing off.
            self._take(_AGAIN)
            if self._theirs is None and perf_counter_ns() - begin > seconds * 1e9:
                reason = f"no datagram from {_text(self._peer)} within {seconds:g} s"
                raise LinkError(reason + self._strangers())
        self._say(Flag.HELLO)
        self._heard = perf_counter_ns()

    def send(self, sequence: int, time: float, values: Array) -> None:
        """Send the values of a step, numbered from 1; time [s]."""
        one = Datagram(Flag.NONE, self._session, sequence, time, perf_counter_ns(), self._echo, values)
        self._sent[sequence] = data = pack(one)
        while len(self._sent) > _KEPT:
            self._sent.popitem(last=False)
        self._counts["sent"] += 1
        self._put(data)

    def latest(self, seconds: float) -> Array | None:
        """The newest values that have come; None before the first.

        A peer that has ended is forgiven for `seconds`: two runs of the same length do not end at once.

        Raises: LinkError if nothing came for `seconds`.
        """
        begin = perf_counter_ns()
        while self._take(0.0) and perf_counter_ns() - begin < seconds * 1e9:
            pass
        age = perf_counter_ns() - self._heard
        if age > seconds * 1e9:
            raise LinkError(self._silence(age))
        if self._latest is None:
            return None
        self._age.add(age)
        return self._latest.values

    def of_step(self, sequence: int, seconds: float) -> Array:
        """The peer's values of a step, waited for. Raises: LinkError if they do not come."""
        begin = perf_counter_ns()
        again = begin + _AGAIN_NS
        while sequence not in self._seen:
            came = self._take(_AGAIN)
            if sequence in self._seen:
                break
            if not came and self._ended:
                raise LinkError(f"{_text(self._peer)} ended its run before its step {sequence}")
            now = perf_counter_ns()
            if now - begin > seconds * 1e9:
                raise LinkError(self._silence(now - begin) + self._strangers())
            if not came or now >= again:
                self._again(sequence)
                again = now + _AGAIN_NS
        return self._seen[sequence]

    def end(self) -> None:
        """Send the end of the run to the peer, three times with the last values, since it does not answer."""
        for _ in range(3):
            for data in self._sent.values():
                self._put(data)
            self._say(Flag.END)

    def statistics(self) -> dict[str, Any]:
        """Counts; times [s]: `age` of values when they were taken, `round_trip` from sending to the answer.

        The round trip holds what the peer took until it sent next, which is up to a step of its own.
        """
        highest = 0 if self._latest is None else self._latest.sequence
        return {
            **self._counts,
            "lost": highest - self._counts["received"],
            "age": self._age.summary(),
            "round_trip": self._round_trip.summary(),
        }

    def _silence(self, nanoseconds: int) -> str:
        which = "a greeting before" if self._latest is None else f"last: its step {self._latest.sequence}"
        end = "; it ended its run" if self._ended else ""
        return f"nothing from {_text(self._peer)} for {nanoseconds * 1e-9:.3g} s ({which}{end})"

    def _strangers(self) -> str:
        """Of datagrams that were not the peer's, for messages."""
        count = self._counts["foreign"]
        return f"; {count} datagrams came that are not its" if count else ""

    def _say(self, flag: Flag) -> None:
        self._put(pack(Datagram(flag, self._session, 0, 0.0, perf_counter_ns(), self._echo, _NOTHING)))

    def _put(self, data: bytes) -> None:
        try:
            self._socket.sendto(data, self._peer)
        except ConnectionError:
            pass  # nobody listens there yet, or any more: missing answers show that
        except OSError as error:
            raise LinkError(f"cannot send to {_text(self._peer)} ({error})") from error

    def _again(self, sequence: int) -> None:
        """Send what the peer may have missed."""
        if sequence in self._sent:
            self._counts["sent_again"] += 1
            self._put(self._sent[sequence])

    def _take(self, seconds: float) -> bool:
        """Take one datagram, waiting for it so long; whether one came."""
        self._socket.settimeout(seconds)
        try:
            data, _ = self._socket.recvfrom(65535)
        except (TimeoutError, BlockingIOError):
            return False
        except ConnectionError:  # some systems report in this way that an earlier datagram was not accepted
            return True
        now = perf_counter_ns()
        one = unpack(data)
        if one is not None and self._theirs is None and not one.flags & Flag.END and one.sequence <= 1:
            self._theirs = one.session
        if one is None or one.session != self._theirs:
            self._counts["foreign"] += 1
            return True
        self._echo = max(self._echo, one.stamp)
        if one.flags & Flag.END:
            self._ended = True
        elif not one.flags & Flag.HELLO:
            self._note(one, now)
        return True

    def _note(self, one: Datagram, now: int) -> None:
        if len(one.values) != self._expected:
            raise LinkError(
                f"{_text(self._peer)} sends {len(one.values)} values, {self._expected} are expected: its "
                "`send` and this side's `receive` name the same values in the same order"
            )
        self._heard = now
        highest = 0 if self._latest is None else self._latest.sequence
        if one.sequence in self._seen or one.sequence <= highest - _REMEMBERED:
            self._counts["duplicates"] += 1
            if self._sent and one.sequence < next(reversed(self._sent)):
                self._again(one.sequence)  # the peer still waits for that step: the answer was lost
            return
        self._counts["received"] += 1
        self._seen[one.sequence] = one.values
        while len(self._seen) > _REMEMBERED:
            self._seen.popitem(last=False)
        if one.echo:
            self._round_trip.add(now - one.echo)
        if one.sequence > highest:
            self._latest = one
        else:
            self._counts["reordered"] += 1


def _text(address: Any) -> str:
    return f"[{address[0]}]:{address[1]}" if ":" in address[0] else f"{address[0]}:{address[1]}"
