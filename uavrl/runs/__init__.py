"""What a run folder holds, under which names, and how it is written and read. It knows no other room of uavrl."""
