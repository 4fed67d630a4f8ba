"""From the table to decisions: verdict, margins, poles and the damping gain."""
