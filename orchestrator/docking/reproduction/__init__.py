"""The paper's figures and numbers, made again by co-simulation: `orchestrator reproduce`.

One experiment is one module: divergence (Fig. 3), cosimulation (6, 7), virtual_walls (8 to 10),
identification (12 to 14), mechanisms (15, 16). `paper` holds what the paper states; all else is computed.
"""

from __future__ import annotations

from .reproduce import Reproduction, reproduce

__all__ = ["Reproduction", "reproduce"]
