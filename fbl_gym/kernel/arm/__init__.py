"""The motion of the arm: rigid, on elastic joints, with links that bend; and its friction."""
