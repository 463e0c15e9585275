"""The experimenter's console: a local web page that shows a running session, in a process of its own.

It listens like the recorder does, and no process of the loop listens to it: only bci-app does, which follows what the
experimenter asks for. Pure are `scores`, `state`, `links`, `averages` and `heads`; `listener` knows LSL, `server` and
`gate` the web.
"""
