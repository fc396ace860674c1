"""All codecs of the bench, strongest families first."""

from families import containers, numbers, quantised, scientific, trajectories


def all_codecs():
    return scientific.codecs() + trajectories.codecs() + quantised.codecs() + numbers.codecs() + containers.codecs()
