from pliant.identify.guided import run, identification
from pliant.identify.found import Identification, PayloadEstimate
from pliant.identify.payload import payload, weighing
from pliant.identify.capture import capture, capturing, Captured
