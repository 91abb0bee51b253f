from pliant.identify.guided import run, identification
from pliant.identify.found import Identification, PayloadEstimate
