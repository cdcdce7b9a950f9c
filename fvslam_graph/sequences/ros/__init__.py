"""ROS bags: their messages, images, frames, poses and sensors."""
