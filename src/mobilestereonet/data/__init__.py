"""Stereo pairs: the sample record, files, public data sets, procedural scenes, augmentation."""
