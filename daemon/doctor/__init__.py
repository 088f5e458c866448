"""`touchd doctor`: whether pad, model, robot and service are as touchd needs them, and what to do if not."""
