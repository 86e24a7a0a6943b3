"""Learners of the literature that the thesis names, as somebody else's parts: nothing in uavrl knows of them."""
