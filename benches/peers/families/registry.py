"""All codecs of the bench, strongest families first."""

from families import containers, numbers, programs, quantised, scientific, trajectories


def all_codecs():
    published = scientific.codecs() + programs.codecs() + trajectories.codecs() + quantised.codecs()
    return published + numbers.codecs() + containers.codecs()
