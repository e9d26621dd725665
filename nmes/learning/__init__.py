"""Learning: environments by the doors that learners know, learners of our own, and datasets; `docs/learning.md`."""
