"""Whether poses and depth images tell the same time, judged as they arrive; no clock in here."""

ANOTHER_CLOCK = 'poses are of another clock than the images'
LASTING = 2_000_000_000     # ns for which stamps that no clock explains must be apart
SLOW = 10_000_000_000       # ns that poses may take to a node that is busy with images
ENOUGH = 5                  # images in that time


class Clocks:
    """
    How far the poses are ahead of the depth images of one camera.

    A pose that is seconds newer than the depth image that arrives with it means one of two things:
    the image took long on its way, or the clocks differ. The clock of the node tells which, where
    it agrees with either; where it agrees with none (a recording played without /clock), the
    clocks differ if the distance lasts.

    Parameters
    ----------
    limit : float
        The setting pose.max_ahead, seconds; 0: never.

    Attributes
    ----------
    ahead : int
        Nanoseconds by which the poses are ahead of the images, 0 where that is within the limit
        or has another reason.
    late : int
        Nanoseconds that the images take, where the poses agree with the node's clock; 0 where
        that is within the limit.

    """

    def __init__(self, limit: float) -> None:
        self.configure(limit)
        self.clear()

    def configure(self, limit: float) -> None:
        """Go on with another limit."""
        self._limit = round(limit * 1e9)

    def clear(self) -> None:
        """Forget what was seen (the clock went back)."""
        self.ahead = self.late = 0
        self._since: int | None = None
        self._count = 0

    def image(self, stamp: int, newest: int | None, clock: int, now: int) -> None:
        """
        Judge by a depth image that arrives.

        Parameters
        ----------
        stamp : int
            Its stamp, ns.
        newest : int or None
            Stamp of the newest pose that had come, ns.
        clock : int
            The node's time, ns.
        now : int
            Nanoseconds of a clock that does not go back.

        """
        apart = 0 if newest is None else newest - stamp
        if not self._limit or apart <= self._limit:
            self.clear()
            return
        self.late = 0
        if abs(stamp - clock) <= self._limit:
            self.ahead = apart
        elif newest is not None and -self._limit <= clock - newest <= max(self._limit, SLOW):
            self.ahead, self.late = 0, apart
        else:
            self._since = now if self._since is None else self._since
            self._count += 1
            lasting = now - self._since >= LASTING and self._count >= ENOUGH
            self.ahead = apart if lasting else 0

    def sentence(self) -> str:
        """Return the sentence that says why frames are refused."""
        return (f'the newest pose is {self.ahead / 1e9:.1f} s newer than the depth image that '
                'came with it: the clocks differ, and every pose would be a wrong one; set them '
                'right (chrony, PTP; use_sim_time for every node or for none), or --set '
                f'pose.max_ahead={2 * self.ahead / 1e9:.0f} if depth images really take that long')
