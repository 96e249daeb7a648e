"""When a frame is too old to be mapped: so that images stay young under any load."""

TARGET = 250_000_000        # ns that a frame may wait for good


class Backlog:
    """
    Drops early where frames come faster than they are mapped.

    As CoDel does in routers (Nichols & Jacobson, 2012): a wait that passes is nobody's harm, one
    that stays is. Once frames have waited for more than `TARGET` for half as long as anything may
    wait (a save, a large refinement and a burst pass sooner), frames are dropped, the oldest
    first, until they wait for less.

    """

    def __init__(self) -> None:
        self._since: int | None = None

    def late(self, age: int, now: int, limit: int) -> bool:
        """
        Return whether a frame is to be dropped.

        Parameters
        ----------
        age : int
            Nanoseconds since it was complete.
        now : int
            Nanoseconds of a clock that does not go back.
        limit : int
            Nanoseconds that nothing may wait for, the setting sync.queue.

        """
        if age < TARGET:
            self._since = None
            return False
        if self._since is None:
            self._since = now
        return age > limit or now - self._since > limit // 2
