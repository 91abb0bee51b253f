from pliant.identify.run import run, identification
from pliant.identify.found import Identification, PayloadEstimate
