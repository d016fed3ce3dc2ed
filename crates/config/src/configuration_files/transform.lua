-- Views along the axes for X-ray images.

XY_TRANSFORM = {
  translation = { 0., 0., 0. },
  rotation = { 0., -math.pi / 2., 0. },
}

XZ_TRANSFORM = {
  translation = { 0., 0., 0. },
  rotation = { 0., 0., -math.pi / 2. },
}

YZ_TRANSFORM = {
  translation = { 0., 0., 0. },
  rotation = { 0., 0., math.pi },
}
