# @mark@
if(CONFIG_SPIKEDEPLOY_@PREFIX@)
  set(policy ${CMAKE_CURRENT_LIST_DIR}/..)
  zephyr_include_directories(${policy})
  zephyr_library_named(spikedeploy_@prefix@)
  zephyr_library_sources(@zephyr_sources@)
@zephyr_choices@
endif()
