"""Parts that lost their trial, as somebody else's parts: nothing in uavrl knows of them."""
