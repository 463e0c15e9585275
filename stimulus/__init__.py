"""What the person sees: the paradigm as a state machine, its picture, and its frame loop."""
