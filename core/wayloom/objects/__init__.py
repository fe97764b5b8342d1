"""Poles, traffic signs, traffic lights and trunks as single objects: found by drives, fused in the map."""
