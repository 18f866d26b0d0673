"""An analysis that knows the truth, or a wrong one: what the scores are proved with."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from microbundle.contraction import rest_weights
from microbundle.data import Beats
from microbundle.synth.render import SyntheticMovie
from microbundle.synth.scores import REST_SAMPLE
from microbundle.synth.truth import true_beats


def same(u):
    return u


@dataclass(frozen=True)
class StandIn:
    """Looks like an Analysis to the scores; `change` spoils the displacement."""

    synthetic: SyntheticMovie
    beats: Beats
    change: object = same
    strain: object = None
    findings: tuple = ()

    @classmethod
    def perfect(cls, synthetic):
        true = true_beats(synthetic.truth)
        markers = synthetic.truth.points_px(6.0)
        u = np.stack([synthetic.truth.displacement_px(markers, t) for t in range(len(true.resting))])
        rest = markers + u[true.resting].mean(axis=0)
        own = [markers + u[true.rest_frames(b)].mean(axis=0) for b in range(len(true))]
        beats = Beats(true.deformation_px, 0.0, true.start, true.peak, true.stop, true.complete, true.resting, rest,
                      np.array(own).reshape(-1, *rest.shape), "default")
        return cls(synthetic, beats)

    def spoiled(self, change):
        return replace(self, change=change)

    @property
    def frame_count(self):
        return self.synthetic.movie.count

    @property
    def tracks(self):
        return SimpleNamespace(lost_fraction=0.0, reference_frame=0, method="truth")

    def displacement_at(self, points_px, *, relative_to="movie"):
        truth, relaxed = self.synthetic.truth, np.flatnonzero(self.beats.relaxed)
        sample = relaxed[np.unique(np.linspace(0, len(relaxed) - 1, REST_SAMPLE).astype(int))]
        X = points_px
        for _ in range(6):
            X = points_px - np.mean([truth.displacement_px(X, int(t)) for t in sample], axis=0)
        u = np.stack([truth.displacement_px(X, t) for t in range(self.frame_count)])
        out = self.change(u - u[relaxed].mean(axis=0))
        if relative_to == "beat" and len(self.beats):
            own = np.tensordot(rest_weights(self.beats.relaxed, self.beats.peak), out, 1)
            out = out - own[self.beats.nearest_beat]
        return out
