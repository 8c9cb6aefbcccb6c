"""Which incarnation of each source a component hears: the latest that has sent.

A component that is lost is started elsewhere, and sends from there. What the lost one
had sent before may still be under way, over a link that was cut: it comes too late.
"""

from __future__ import annotations

from poise.wire.codec import WireError
from poise.wire.records.deployment import ConnectorSpec


class OvertakenSources:
    """The latest incarnations of the sources of one component; any thread may ask.

    In a move all that the source sent has come before the target sends.
    """

    def __init__(self) -> None:
        self._latest: dict[str, int] = {}

    def note(self, connector: str, epoch: int) -> bool:
        """Note that a message came; return whether a later incarnation has sent.

        Parameters
        ----------
        epoch
            Of the source that sent it.
        """
        latest = self._latest.setdefault(connector, epoch)
        if epoch > latest:
            self._latest[connector] = epoch
        return epoch < latest

    def check(self, spec: ConnectorSpec) -> None:
        """Note that a message came over a connector.

        Raises
        ------
        WireError
            A later incarnation of its source has sent.
        """
        if self.note(spec.name, spec.source_epoch):
            raise WireError(
                f"a message of '{spec.source}' ({spec.source_epoch}) comes after one "
                "of a later incarnation: it was under way for too long"
            )

    def forget(self, connector: str, epoch: int) -> None:
        """Hear earlier incarnations again: this one is not joined any more."""
        if self._latest.get(connector) == epoch:
            del self._latest[connector]
