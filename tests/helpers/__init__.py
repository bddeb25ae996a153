"""What tests share: problems, designs, model files, commands, and second routes."""
