"""From verdicts and sensors to the next move: observation, network, training, evaluation, server."""
