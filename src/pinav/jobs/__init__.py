"""Jobs: the units of work behind the commands, each resumable in a run folder."""
