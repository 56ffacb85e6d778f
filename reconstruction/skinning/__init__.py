"""Many sections to one surface: the method ``fit``, in space.

outlines of every slice -> branches -> a tensor surface each -> one solid
         `outlines`        `branching`   `aligning`, `tensor_fit`   `joining`
"""
