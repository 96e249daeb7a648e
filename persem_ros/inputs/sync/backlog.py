"""When a frame is too old to be mapped: so that images stay young under any load."""

TARGET = 250_000_000        # ns that a frame may wait for good


class Backlog:
    """
    Drops early where frames come faster than they are mapped.

    As CoDel does in routers (Nichols & Jacobson, 2012): a wait that passes is nobody's harm, one
    that stays is. Once frames have waited for more than `TARGET` for half as long as anything may
    wait (a save, a large refinement and a burst pass sooner), whatever has waited for longer is
    dropped, until frames have been young for that long again. One frame in that time is taken
    nevertheless: a map that is late is better than none.

    """

    def __init__(self) -> None:
        self._behind = False
        self._turned: int | None = None     # since when frames are as they were not before
        self._taken = 0                     # when the last frame was taken

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
        old = age >= TARGET
        if old == self._behind:
            self._turned = None
        elif self._turned is None:
            self._turned = now
        elif now - self._turned > limit // 2:
            self._behind, self._turned = old, None
        if age > limit or old and self._behind and now - self._taken <= limit // 2:
            return True
        self._taken = now
        return False
