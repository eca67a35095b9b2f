"""The coupling ledger: how much energy the coupling itself makes at every power bond; see `books`."""

from .books import Before, Books, Step
from .ledger import Account, Ledger

__all__ = ["Account", "Before", "Books", "Ledger", "Step"]
