# SPDX-License-Identifier: Apache-2.0
"""An effect of which the user has fixed some searched parameters."""

from dataclasses import dataclass

from rosette_ros.core.effects.contract import Effect, Setting


@dataclass(frozen=True)
class Pinned(Effect):
    """Another effect with some searched parameters held at given values."""

    effect: Effect = None
    fixed: Setting = None

    @staticmethod
    def of(effect, fixed):
        """Return the effect itself where nothing is fixed, else the effect pinned."""
        if not fixed:
            return effect
        return Pinned(name=effect.name, meaning=effect.meaning, look=effect.look,
                      formula=effect.formula, source=effect.source, depends_on=effect.depends_on,
                      searched=effect.searched, effect=effect, fixed=Setting(fixed))

    def unavailable(self, run):
        """Ask the effect."""
        return self.effect.unavailable(run)

    def settings(self, run):
        """Return the effect's settings with the fixed values in their place, each once."""
        return tuple(dict.fromkeys(
            Setting({**setting, **self.fixed}) for setting in self.effect.settings(run)))

    def brackets(self, run, setting):
        """Refine what is not fixed."""
        return {name: bracket for name, bracket in self.effect.brackets(run, setting).items()
                if name not in self.fixed}

    def independent_settings(self, run):
        """Ask the effect, at most as many as there are settings left."""
        return max(1, min(self.effect.independent_settings(run), len(self.settings(run))))

    def amplitudes(self, run, setting):
        """Ask the effect."""
        return self.effect.amplitudes(run, setting)

    def columns(self, run, setting):
        """Ask the effect."""
        return self.effect.columns(run, setting)

    def blocks(self, run, settings):
        """Ask the effect."""
        return self.effect.blocks(run, settings)

    def factors(self, run, settings):
        """Ask the effect."""
        return self.effect.factors(run, settings)

    def width(self, run, setting):
        """Ask the effect."""
        return self.effect.width(run, setting)
