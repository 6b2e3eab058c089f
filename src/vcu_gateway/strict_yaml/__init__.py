"""Files that people write, read strictly: lines, types, problems with remedies."""
