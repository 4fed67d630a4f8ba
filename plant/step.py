"""The former name of `plant.boxes.step_function`, kept for one release."""

from .boxes.step_function import plant_from_lanes, plant_from_step

__all__ = ["plant_from_lanes", "plant_from_step"]
