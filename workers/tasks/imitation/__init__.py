"""Motions learnt from clips: the athlete follows a reference (DeepMimic, Peng et al. 2018)."""
