"""Motion and sensors: the function, its Jacobian and its noise stand together."""
