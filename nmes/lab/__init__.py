"""The lab: a server of pages in which worlds, creatures and runs are made, watched and judged in a browser."""
