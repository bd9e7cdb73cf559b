"""The camera of a picture: keypoints, votes, outlines and climbs propose it; brightness refines it."""
