"""Recordings as other people's programs read them: a BIDS dataset of a study, or one run as BrainVision or EEGLAB.

`grid`, `clocks`, `signals` and `events` say what is in the files, `columns`, `words` and `about` what it means,
`tables` and `files` write them, `dataset` and `plain` put them where they belong.
"""
