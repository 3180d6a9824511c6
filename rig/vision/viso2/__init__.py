"""A monocular front end in the style of viso2 (Geiger, Ziegler, Stiller: StereoScan, IV 2011).

Written from published descriptions; `front_end.Viso2FrontEnd` puts the stages together.
"""
