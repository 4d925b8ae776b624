"""`python -m campaigns NAME`, from the root of a checkout: list the campaigns, or run one."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from campaign_table import main

if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
