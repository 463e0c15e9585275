"""From raw EEG to a verdict: the linear chain, epochs, classifier, calibration, and a participant to try it on."""
