"""Worlds and recordings as Rerun shows them: live, or on a time line to go back and forth on.

`canvas` hides what becomes which entity, `screen` how all of it is laid out and how Rerun's programs are started and
end; `recordings` and `live` are the two things there are to see.

Invariants: the time line is `time`, in s since the world or the recording began; what is shown stays until something
else is shown in its place, and only what changed is sent; a viewer only looks.
"""
