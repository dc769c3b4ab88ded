"""Does it hold? The experiments of the literature, scripted and judged; the checks of the installed package."""
