"""
What looks at a recording or at a finished run and gives advice, before and after.

In: recordings, settings, what a run used and left. Out: sentences with what to type.
Entered by info, replay, evaluate and the node; writes nothing.

Before mapping: `look.opened(path, config)` opens a recording for a replay or an evaluation,
`look.look(sample)` runs every check over a Sample (`recorded.sample` makes one of a recording, a
node its own of what it has seen) and returns Findings. A check is a generator in a file named for
its subject, `check(sample) -> Iterator[Finding]`, and one entry in `look.CHECKS`; they run in that
order, and the settings that a finding *takes* hold for the checks after it. A Finding says
REFUSE, WARN or NOTE in one sentence without flags, and its Remedies hold the settings to type, so
that the command line shows `--set a=b` and the node `-p a:=b`.

"""
