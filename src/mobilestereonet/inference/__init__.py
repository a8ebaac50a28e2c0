"""From a pair of images to a disparity map."""
