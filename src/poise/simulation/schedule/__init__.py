"""Virtual time: who runs next, what a process gets of the standard library, replays."""
