"""torchvision's detection models: Faster, Mask and Keypoint R-CNN, RetinaNet, FCOS, SSD and SSDlite."""
