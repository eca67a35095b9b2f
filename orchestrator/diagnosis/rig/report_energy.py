"""Tables of energies on a diagnosis' page: of residuals, and at interfaces."""

from __future__ import annotations

from html import escape

from ...plotting.page import note, table
from .verdict import Diagnosis

# Shares above this have full colour.
_FULL = 0.5


def ledger(diagnosis: Diagnosis) -> str:
    """Residual energy by component, phase of motion and band, as a table."""
    if not diagnosis.ledger:
        return ""
    components = list(dict.fromkeys(one.component for one in diagnosis.ledger))
    phases = list(dict.fromkeys(one.phase for one in diagnosis.ledger))
    bands = list(dict.fromkeys(one.band for one in diagnosis.ledger))
    shares = {(one.component, one.phase, one.band): one.share for one in diagnosis.ledger}
    head = "".join(f"<th class=phase colspan={len(bands)}>{escape(phase)}</th>" for phase in phases)
    sub = "".join(f"<th class=band>{escape(band)}</th>" for _ in phases for band in bands)
    body = ""
    for component in components:
        cells = [shares.get((component, phase, band), 0.0) for phase in phases for band in bands]
        body += f"<tr><th>{escape(component)}</th>{''.join(map(_heat, cells))}{_heat(sum(cells))}</tr>"
    words = (
        "Excess over noise, in percent of all of it, by component, phase of motion and frequency band. "
        "Cells add up to 100."
    )
    return (
        f"<h2>Residual energy</h2>{note(words)}"
        f"<div class=wide><table class=heat><tr><th></th>{head}"
        f"<th>all</th></tr><tr><th></th>{sub}<th></th></tr>{body}</table></div>"
    )


def _heat(share: float) -> str:
    depth = min(abs(share) / _FULL, 1.0) ** 0.5
    colour = f"rgba(213,94,0,{0.75 * depth:.2f})" if share >= 0 else f"rgba(0,114,178,{0.75 * depth:.2f})"
    text = f"{100 * share:.1f}"
    return f'<td style="background:{colour}">{text.removeprefix("-") if float(text) == 0 else text}</td>'


def energy(diagnosis: Diagnosis) -> str:
    """Energy at interfaces, as a table; "-" where a model runs away."""
    balance = diagnosis.energy
    if not balance.get("interfaces"):
        return ""
    columns = [name for name in ("measured", "nominal", "excess", "answer") if name in balance]
    cells = [(one, {name: balance[name][one] for name in columns}) for one in balance["interfaces"]]
    rows = [
        [one, *("-" if values[name] is None else f"{values[name]:+.4f}" for name in columns)]
        for one, values in (*cells, ("CoR^2 - 1", balance["change"]))
    ]
    words = (
        "CoR^2 - 1, the share of kinetic energy that a contact adds, by the interface at which it enters; "
        "mean over held-out contacts, or all where no run was held out. Excess is measured less nominal."
    )
    return f"<h2>Energy of a contact</h2>{note(words)}{table(['', *columns], rows[:-1], foot=rows[-1])}"
