from .response import FRF as FRF
