"""What the module Osteoflow of 3D Slicer does. Python files beside Osteoflow.py itself would be taken for modules of their own."""
